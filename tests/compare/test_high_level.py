"""The comparison of policies over the whole-body controller with joint targets: what is counted, and what is said."""

import json

import jax
import numpy as np
import pytest

from experiments import high_level_section
from loco_mjx.cli import train
from loco_mjx.compare.cells import Plan
from loco_mjx.config import flatten, to_dict
from loco_mjx.run.results import variant_of
from loco_mjx.run.variant import parse_variant
from loco_mjx.scene import mjcf
from loco_mjx.scene.tasks import get_task
from tests.known_robots import A1

pytest.importorskip("quadprog")  # the extra `mpc`


def test_a_collision_is_a_contact_after_a_while_without_any():
    from experiments.high_level import APART, Counting

    scene = jax.jit(get_task("thin").generate)(jax.random.PRNGKey(0))
    robot = Counting(mjcf.scene_spec(scene, A1).compile(), None, lying=False, policy_hz=20)
    free, still = robot.data.qpos.copy(), np.array(A1.default_pose)
    post = robot.model.geom("obstacle_0_contact")
    at_post = free.copy()
    at_post[:2] = post.pos[:2] - [post.size[0] + 0.15, 0.0]

    def stay(pose, seconds):
        for _ in range(round(seconds * 400)):
            robot.data.qpos[:], robot.data.qvel[:] = pose, 0.0
            robot.command(still, 40.0, 1.0)
        return robot.collisions

    assert stay(free, 0.1) == 0
    assert stay(at_post, 0.1) == 1 and stay(free, 0.5 * APART) == 1 and stay(at_post, 0.1) == 1
    assert stay(free, 1.1 * APART) == 1 and stay(at_post, 0.1) == 2


@pytest.mark.parametrize("text", ["visual-cnn+controller=mpc", "visual-cnn+layers=1+env.controller=mpc"])
def test_a_sweep_knows_a_controller_without_what_comes_with_it(text, tmp_path):
    variant = parse_variant(text)
    (cell,) = Plan(tmp_path, total_steps=4096).group("thin", variant, [0]).values()
    flat = flatten(to_dict(cell.config))
    assert set(variant_of(flat).label.split("+")) == {part.removeprefix("env.") for part in text.split("+")}
    assert variant.matches(flat) and not parse_variant("visual-cnn").matches(flat)
    words = cell.train_command()
    assert train.configuration(train.read(words[words.index("train") + 1 :])) == cell.config


def written(folder):
    """Results of two methods on one task, and of one run."""
    (folder / "compare").mkdir(parents=True)
    (folder / "runs" / "visual-cnn-seed0").mkdir(parents=True)
    about = {"task": "indoor", "seconds": 20.0, "apart": 1.0, "trained_on": "thin"}
    rows = [{"distance": 4.0, "collisions": 1, "stopped": None}, {"distance": 6.0, "collisions": 2, "stopped": "tilt"}]
    for name, policy, controller in (("visual-cnn", "visual-cnn", "mpc"), ("end-to-end", "loco-transformer", "pd")):
        result = about | {"name": name, "policy": policy, "controller": controller, "samples": 4096, "rows": rows}
        (folder / "compare" / f"{name}-indoor.json").write_text(json.dumps(result))
    run = folder / "runs" / "visual-cnn-seed0"
    (run / "config.json").write_text(json.dumps({"policy": "visual-cnn"}))
    lines = ["step,time/seconds,time/samples_per_second,step/unsolved,episode/return,eval/return,eval/distance"]
    lines += ["4096,30,100,0.1,20,25,2.5", "8192,60,300,0.0,30,35,3.5", "12288,90,200,0.0,30,,"]
    (run / "metrics.csv").write_text("\n".join(lines) + "\n")


def test_ours_stand_beside_the_papers_and_are_said_to_be_simulated(tmp_path, monkeypatch):
    monkeypatch.setattr(high_level_section, "FOLDER", tmp_path)
    assert high_level_section.high_level() == ""
    written(tmp_path)
    said = high_level_section.high_level()
    assert "**Simulation, not the real world.**" in said and "20 s each" in said and "2 scenes each" in said
    assert "| indoor | walk | `visual-cnn` | 5.0 ± 1.0 | 1.5 ± 0.5 | 1 of 2 | 7.5 ± 1.5 | 3.4 ± 0.8 |" in said
    assert (
        "| indoor | joint targets | `loco-transformer` | 5.0 ± 1.0 | 1.5 ± 0.5 | 1 of 2 | 9.6 ± 2.2 | 0.3 ± 0.5 |"
        in said
    )
    assert "| `visual-cnn` | CNN | depth | 12,288 | 2 min | 200 | 35.0 | 3.50 m | 0.33% |" in said
    high_level_section.curves(tmp_path)
    assert (tmp_path / high_level_section.CURVES).stat().st_size > 1000
