"""A policy's folder names its robot, and no other robot is run by it."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.config import Config, EnvConfig, with_robot
from loco_mjx.deploy import folder
from loco_mjx.deploy.description import describe
from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.runner import Runner
from tests.deploy import flat
from tests.known_robots import A1, GO1, GO2
from tests.refusals import refusal, says


def scene(robot) -> str:
    """MJCF of a robot on a plane, as scenes are called."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    spec.modelname = f"{robot.name}_scene"
    geom = {"contype": 2, "conaffinity": 1, "group": 2}
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], **geom)
    spec.compile()
    return spec.to_xml()


def described(robot) -> dict:
    """What a manifest of a policy for a robot says that follows from its configuration."""
    config = with_robot(Config(policy="made up", env=EnvConfig(observation=flat.OBSERVED)), robot.name)
    return describe(config, ("state", "depth"), 1)


@pytest.fixture
def go2(tmp_path):
    (tmp_path / "policy").mkdir()
    return flat.write(tmp_path / "policy", described(GO2))


def test_a_manifest_holds_its_robots_figures(go2):
    manifest = folder.read(go2)
    assert manifest.robot == "go2" and manifest.camera.offset == GO2.camera
    np.testing.assert_array_equal(manifest.torque_limit, GO2.torque_limit)
    np.testing.assert_array_equal(manifest.lower, GO2.lower)
    assert folder.build(flat.raw()).camera.offset == A1.camera


def test_the_go2_stands_up_runs_and_sits_down(go2, tmp_path, capsys):
    (tmp_path / "scene.xml").write_text(scene(GO2))
    log = tmp_path / "run.npz"
    words = ["deploy", str(go2), "--robot", "mujoco", "--scene", str(tmp_path / "scene.xml"), "--seconds", "1"]
    assert main([*words, "--limits.missed", "100", "--log", str(log)]) == 0, capsys.readouterr()
    with np.load(log) as run:
        np.testing.assert_allclose(run["angles"][-1], GO2.default_pose, atol=0.2)


def test_another_robot_is_refused(go2, tmp_path, capsys):
    (tmp_path / "scene.xml").write_text(scene(GO1))
    assert main(["deploy", str(go2), "--scene", str(tmp_path / "scene.xml")]) == 2
    assert says(capsys.readouterr().err, "policy go2 robot go1")
    assert main(["deploy", str(go2), "--robot", "a1"]) == 2
    assert says(capsys.readouterr().err, "policy go2 --robot a1")
    robot = MujocoRobot(flat.model(), flat.manifest().camera)
    with refusal("policy go2 robot a1"):
        Runner(folder.read(go2), flat.still, robot, clock=flat.clock).run(0.1)


def test_a_manifest_of_before_robots_had_names_is_an_a1s(tmp_path):
    old = json.loads(json.dumps(flat.raw()))
    del old["robot"], old["config"]["env"]["robot"]
    assert "robot" not in old
    flat.write(tmp_path)
    kept = json.loads((tmp_path / folder.MANIFEST).read_text())["files"]
    old["config_hash"] = flat.hashed(old["config"])
    flat.write_manifest(tmp_path, old | {"files": kept})
    assert folder.read(tmp_path).robot == "a1"


def test_figures_of_another_robot_are_refused(go2):
    said = json.loads((go2 / folder.MANIFEST).read_text())
    for change, words in (
        ({"robot": "a1"}, "robot a1 go2"),
        ({"joints": described(GO1)["joints"]}, "joints.upper 1.0472"),
    ):
        changed = {key: value for key, value in (said | change).items() if key != "sha256"}
        flat.write_manifest(go2, changed)
        with refusal(words):
            folder.read(go2)
