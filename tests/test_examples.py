"""The examples do what they say, at tiny sizes; what they register works with the commands."""

import functools
import importlib.util
import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import loco_mjx
from loco_mjx.cli.main import main
from loco_mjx.config import Config, EnvConfig
from loco_mjx.config.reward_terms import REWARDS
from loco_mjx.deploy import folder, trained
from loco_mjx.deploy.session import Session
from loco_mjx.evaluation import report
from loco_mjx.evaluation.episodes import Evaluator
from loco_mjx.networks.registry import POLICIES
from loco_mjx.robots import ROBOTS
from loco_mjx.run import needs, start
from loco_mjx.run.directory import load_config
from loco_mjx.run.logger import read_rows
from loco_mjx.scene.tasks import TASKS
from tests.deploy import made
from tests.optional import needs_opengl
from tests.refusals import refusal

EXAMPLES = Path(__file__).parents[1] / "examples"
MODULES = ("custom_task", "custom_policy", "custom_reward")
IMPORTS = [word for name in MODULES for word in ("--import", str(EXAMPLES / f"{name}.py"))]
OWN = (TASKS, "slalom"), (POLICIES, "gated"), (REWARDS, "calm"), (REWARDS, "straight")
SIZES = {"ppo.unroll": 4, "ppo.minibatch": 16, "ppo.epochs": 1, "ppo.pool_size": 2, "env.horizon": 8}
SIZES |= {"env.physics.iterations": 1, "env.physics.more_iterations": 0, "env.physics.near_boxes": 1}
OPTIONS = [word for key, value in SIZES.items() for word in (f"--{key}", str(value))]


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def forget():
    for name in MODULES:
        sys.modules.pop(name, None)
    for registry, name in OWN:
        if name in registry:
            registry.unregister(name)


@pytest.fixture(scope="module", autouse=True)
def trainers():
    """Runs of one configuration share their trainer and their evaluator, and so the compiled programs."""
    patch, evaluators = pytest.MonkeyPatch(), {}

    def evaluator(env, networks, *args, **kwargs):
        made = Evaluator(env, networks, *args, **kwargs)
        return evaluators.setdefault((env.config, networks.module, made.deterministic), made)

    patch.setattr(start, "build", functools.cache(start.build))
    patch.setattr(report, "Evaluator", evaluator)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def run(tmp_path_factory, trainers):
    """A run of the example's task, with its policy and its terms of the reward, by the command."""
    path = tmp_path_factory.mktemp("own") / "run"
    words = ["--task", "slalom", "--policy", "gated", "--num-envs", "4", "--total-steps", "32", "--evaluations", "0"]
    assert main(["train", *IMPORTS, *words, *OPTIONS, "--env.reward.straight", "0", "--out", str(path)]) == 0
    yield path
    forget()


def test_a_run_of_ones_own_notes_its_modules_and_rewards(run):
    config = load_config(run)
    assert config.imports == tuple(IMPORTS[1::2])
    assert config.env.reward.terms == {"calm": 0.001, "straight": 0.0}
    row = read_rows(run / "metrics.csv")[-1]
    assert float(row["step/reward/calm"]) < 0 and "step/reward/straight" not in row


def test_training_from_python_stops_when_it_walks_well_enough(run, tmp_path, monkeypatch, capsys):
    """On the run's configuration, whose programs are compiled by now."""
    module = load("train_from_python")
    monkeypatch.setattr(module, "FAR_ENOUGH", -1.0)
    keys = SIZES | {"env.reward.straight": 0.0}
    own = {"task": "slalom", "policy": "gated", "num_envs": 4, "total_steps": 32, "keys": keys}
    result = module.main(str(tmp_path / "run"), **own)
    assert load_config(tmp_path / "run") == load_config(run)
    assert result["samples"] == 16 and "distance" in result["metrics"]  # stopped after the first iteration
    assert capsys.readouterr().out.count("reward per step") == 1


def cells():
    found = json.loads((EXAMPLES / "quickstart.ipynb").read_text())["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == "code"]


def test_the_notebook(run, tmp_path, monkeypatch):
    """All cells but the film's; in place of the parameters tiny sizes, and the run's task and policy."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    parameters, *others = cells()[:-1]
    exec(parameters, names)
    assert names["SAMPLES"] >= 100_000
    keys = SIZES | {"env.task": "slalom", "policy": "gated", "env.reward.straight": 0.0}
    names |= {"SAMPLES": 32, "ENVS": 4, "EPISODES": 8, "KEYS": keys}
    for cell in others:
        exec(cell, names)
    assert load_config(tmp_path / names["OUT"]) == load_config(run)
    assert [samples for samples, _ in names["curve"]] == [16, 32] and names["outcome"].samples == 32
    assert names["result"]["num_episodes"] == 8


def test_it_is_evaluated_exported_and_missed(run, capsys, tmp_path):
    assert main(["evaluate", str(run), *IMPORTS, "--episodes", "8", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["policy"], result["task"]) == ("gated", "slalom") and result["metrics"]["reward/calm"]["mean"] < 0
    out = tmp_path / "policy"
    assert main(["export", str(run), *IMPORTS, "--out", str(out)]) == 0
    policy, session = loco_mjx.load_policy(out), Session(folder.read(out), out)
    obs = {name: views[0] for name, views in made.observations(1).items()}
    targets = session(obs)
    scale = np.tile(policy.config.env.action.scale, 4)
    away = targets - folder.read(out).default_pose
    assert away == pytest.approx(policy.act({"state": obs["state"], "pixels/depth": obs["depth"]}) * scale, abs=1e-4)
    forget()
    for path in (run, out):
        with refusal("slalom --import custom_task.py"):
            trained.load(path)
    assert main(["evaluate", str(out)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_robot_of_ones_own(tmp_path):
    try:
        words = ["--import", str(EXAMPLES / "custom_robot.py"), "--robot", "go2-loaded", "--out"]
        assert main(["scene", *words, str(tmp_path / "own.xml")]) == 0
        assert main(["scene", "--robot", "go2", "--out", str(tmp_path / "go2.xml")]) == 0
        own, plain = (mujoco.MjModel.from_xml_path(str(tmp_path / f"{name}.xml")) for name in ("own", "go2"))
        assert own.body_mass.sum() - plain.body_mass.sum() == pytest.approx(2.0)
        assert needs.with_imports(Config(env=EnvConfig(robot="go2-loaded"))).imports == (words[1],)
    finally:
        sys.modules.pop("custom_robot", None)
        ROBOTS.unregister("go2-loaded")


def test_acting_in_a_loop(capsys):
    distance = load("act_in_a_loop").main("mountain-blind", steps=5)
    assert abs(distance) < 0.5 and "mountain-blind on mountain" in capsys.readouterr().out


@needs_opengl
def test_the_notebooks_film(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__", "loco_mjx": loco_mjx, "OUT": "mountain-blind", "SECONDS": 0.08}
    exec(cells()[-1], names)
    assert names["film"]._repr_html_().startswith("<video") and Path("quickstart.mp4").stat().st_size > 1000
