"""The two sides tell the same story of the same policy; each part of the comparison by itself."""

from __future__ import annotations

import dataclasses
import io
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from loco_mjx import make_env
from loco_mjx.cli.main import main
from loco_mjx.config import DepthConfig, EnvConfig, ObservationConfig, with_robot
from loco_mjx.deploy import export, folder
from loco_mjx.env.state import State
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.types import OBSTACLE, STEP
from loco_mjx.simcheck import replay, report
from loco_mjx.simcheck.run import compare, run
from loco_mjx.simcheck.sides import CSide, WatchedRobot, start
from tests.deploy import flat, made
from tests.known_robots import A1, GO2
from tests.physics import world
from tests.refusals import says

HORIZON = 12
BLIND = ObservationConfig(depth=DepthConfig(enabled=False))


@pytest.fixture(params=["a1", "go2 by its path"])
def policy(tmp_path, monkeypatch, request):
    """A folder with a policy of random weights that flings its legs about; the file of its robot is gone."""
    robot = request.param
    if robot != "a1":
        robot = str(tmp_path / "mine.xml")
        Path(robot).write_text(GO2.path.read_text().replace('model="go2"', 'model="mine"'))
    monkeypatch.setattr(export, "stablehlo", lambda policy: b"")
    random = made.policy("state-only")
    env = dataclasses.replace(random.config.env, observation=BLIND, horizon=HORIZON)
    config = with_robot(dataclasses.replace(random.config, env=env), robot)
    export.write(dataclasses.replace(random, config=config), tmp_path / "policy")
    Path(robot).unlink(missing_ok=True)
    return tmp_path / "policy"


def test_both_sides_agree_while_chaos_has_not_begun(policy, capsys, monkeypatch):
    """Any difference in observation, timing, gains, joint order or torque shows within half a second."""
    monkeypatch.setattr(replay, "LENGTH", 5)
    monkeypatch.setattr(replay, "APART", 6)
    assert main(["simcheck", str(policy), "--episodes", "2", "--seed", "3", "--solver", "12", "12", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["task"], result["num_episodes"], result["policy"]) == ("thin", 2, "state-only")
    c, mjx = (result["episodes"][name] for name in ("C MuJoCo", "MJX"))
    assert set(c) == set(mjx) and c["length"] == mjx["length"] and max(c["length"]) > 5
    np.testing.assert_allclose(c["reward/energy"], mjx["reward/energy"], rtol=0.005)
    np.testing.assert_allclose(c["distance"], mjx["distance"], atol=0.001)
    assert min(np.abs(c["distance"])) > 0.02 or np.ptp(c["distance"]) > 0.02  # it does move
    np.testing.assert_allclose(c["return"], mjx["return"], atol=0.001 / A1.control_dt)
    row = result["metrics"]["distance"]
    assert row["difference"] == pytest.approx(row["c_mean"] - row["mjx_mean"])
    again = result["replay"]
    assert again["windows"] >= 2 and again["targets"]["max"] < 1e-3
    assert again["distance"]["c_mean"] == pytest.approx(again["distance"]["mjx_mean"], abs=1e-4)
    shown = _printed(result)
    distance = f"{again['distance']['mjx_mean']:.4f}"
    assert says(shown, f"{again['windows']} 0.2 s {distance} {again['targets']['mean']:.1e} rad")
    assert distance not in _printed(result | {"replay": {"windows": 0}})


def _printed(result):
    console = Console(record=True, width=200, file=io.StringIO())
    console.print(report.table(result))
    return console.export_text()


def test_bad_input(policy, tmp_path, capsys):
    for words, said in (
        ([str(tmp_path / "none")], f"{tmp_path}/none export"),
        ([str(policy), "--task", "thn"], "thn thin"),
        ([str(policy), "--episodes", "0"], "episodes 0 1"),
        ([str(policy), "--solver", "0", "8"], "solver (0, 8) 1 1000"),
    ):
        assert main(["simcheck", *words]) == 2
        assert says(capsys.readouterr().err, said)
    raw = json.loads((policy / folder.MANIFEST).read_text())
    raw["config"]["env"]["weather"] = "fine"
    (policy / folder.MANIFEST).write_text(json.dumps(raw))
    assert main(["simcheck", str(policy)]) == 2


def test_a_policy_that_reads_the_goal_is_refused_before_anything_runs(tmp_path, capsys):
    flat.write(tmp_path, {name: value for name, value in flat.raw(goal=True).items() if name != "files"})
    assert main(["simcheck", str(tmp_path), "--task", "mountain", "--episodes", "1"]) == 2
    assert says(capsys.readouterr().err, "goal --env.observation.goal")


@pytest.mark.parametrize(("kind", "contact"), [(OBSTACLE, True), (STEP, False)])
def test_contact_is_with_obstacles_not_with_what_one_stands_on(kind, contact):
    box = {"center": (0.0, 0.0, 0.0), "half": (0.5, 0.5, 0.005), "kind": kind}
    robot = WatchedRobot(scene_spec(world.scene([box]), A1).compile(), None, lying=False)
    robot.data.qpos[2] = A1.stand_height + 0.004  # the feet 1 mm into the box
    squared = 0.0
    for _ in range(3):
        robot.command(np.array(A1.default_pose), 40.0, 0.6)
        squared += np.sum(robot.data.ctrl**2)
    assert robot.data.ncon >= 4 and robot.contact == contact
    assert robot.torque_squared == pytest.approx(squared) and squared > 0.1
    robot.forget()
    assert not robot.contact and robot.torque_squared == 0.0


def test_moving_obstacles_are_where_the_environment_has_them():
    env = make_env("moving", EnvConfig(observation=BLIND))
    manifest = dataclasses.replace(flat.manifest(), camera=None)
    first = start(env, 0, 2)
    with ThreadPoolExecutor(2) as pool:
        side = CSide(env, manifest, flat.still, pool)
        state = side.begin(first)
        for t in range(3):
            state = side.step(state, t, np.array([True, True]))
    for i, robot in enumerate(side.robots):
        np.testing.assert_allclose(robot.data.qpos[:3], state.pipeline_state.physics.qpos[i, :3], atol=1e-6)
        body = robot.model.body("obstacle_7")
        now = np.asarray(state.pipeline_state.scene.boxes.center[i, 7])
        np.testing.assert_allclose(robot.data.mocap_pos[body.mocapid[0]], now, atol=1e-6)
    moved = np.asarray(state.pipeline_state.scene.boxes.center - first.pipeline_state.scene.boxes.center)
    assert np.abs(moved[:, :50, :2]).max() == pytest.approx(3 * A1.control_dt * 0.42, rel=0.15)


class Counting:
    """Step t is worth t; episode i ends after i + 2 steps, and is worth 100 a step after that."""

    name = "counting"

    def begin(self, state):
        return state

    def step(self, state, t, alive):
        end = np.arange(3) + 2
        worth = np.where(t + 1 > end, 100.0, t + 1)
        assert not np.any(alive & (t + 1 > end))
        return state.replace(reward=2 * worth, done=(t + 1 == end) * 1.0, metrics={"distance": worth})


def test_figures_are_sums_up_to_the_first_done():
    zero, ticks = np.zeros(3), []
    first = State(None, {}, zero, zero, {"distance": zero}, {"truncation": np.array([0.0, 1.0, 0.0])})
    found = run(Counting(), first, 10, 0.04, lambda *tick: ticks.append(tick))
    np.testing.assert_array_equal(found["length"], [2, 3, 4])
    np.testing.assert_array_equal(found["distance"], [3, 6, 10])
    np.testing.assert_array_equal(found["return"], [6, 12, 20])
    np.testing.assert_array_equal(found["survived"], [0, 1, 0])
    assert ticks[-1] == ("counting", 4, 10)


def test_comparison_is_paired():
    """Scenes differ by metres, the sides by 10 cm in each: the error is that of the sides' difference."""
    mjx = {"distance": np.array([1.0, 5.0, 9.0]), "spheres": np.zeros(3)}
    c = {"distance": np.array([1.1, 5.2, 9.0]), "spheres": np.zeros(3)}
    rows = compare(c, mjx)
    assert rows["distance"]["difference"] == pytest.approx(0.1)
    assert rows["distance"]["standard_error"] == pytest.approx(0.1 / np.sqrt(3))
    assert rows["distance"]["ratio"] == pytest.approx(5.1 / 5.0)
    assert rows["spheres"]["ratio"] is None
    assert compare({"x": np.ones(1)}, {"x": np.ones(1)})["x"]["standard_error"] is None


def test_starts_are_those_of_an_evaluation():
    env = make_env("thin", EnvConfig(observation=BLIND))
    key = jax.random.fold_in(jax.random.PRNGKey(5), 1)
    alone = jax.jit(env.reset)(jax.random.split(key)[0])
    both = start(env, 5, 2)
    np.testing.assert_allclose(both.pipeline_state.physics.qpos[1], alone.pipeline_state.physics.qpos, atol=1e-6)
    np.testing.assert_allclose(both.pipeline_state.scene.boxes.center[1], alone.pipeline_state.scene.boxes.center)
