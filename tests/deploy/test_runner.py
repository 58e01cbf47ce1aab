"""The loop: histories newest first, rates, stand up and sit down, the depth image, the record; and no JAX."""

import json
import subprocess
import sys

import numpy as np
import pytest

from loco_mjx.deploy import folder
from loco_mjx.deploy.mujoco_robot import Imperfections, MujocoRobot
from loco_mjx.deploy.observer import Observer
from loco_mjx.deploy.robot import Frame, Sensors
from loco_mjx.deploy.session import Session
from tests.deploy import flat
from tests.known_robots import A1
from tests.refusals import refusal, says

POSE = np.array(A1.default_pose)


def sensors(t, **more):
    base = {
        "angles": POSE + t,
        "velocities": np.zeros(12),
        "quat": np.array([1.0, 0, 0, 0]),
        "gyro": np.full(3, 1.0 * t),
    }
    return Sensors(**({"time": 0.0, "position": np.array([2.0 * t, 0.0, 0.3])} | base | more))


def test_history_is_newest_first_and_starts_with_copies():
    observer = Observer(flat.manifest())
    frame = Frame(0.0, np.full((8, 8), 2.0))
    first = observer.observe(sensors(1), frame, POSE)["state"]
    displacement, imu, action, angles = np.split(first, [9, 21, 57])
    assert not displacement.any() and not action.any()
    np.testing.assert_allclose(imu, [0, 0, 1, 1] * 3, atol=1e-7)
    np.testing.assert_allclose(angles, np.tile(POSE + 1, 3), rtol=1e-6)
    observer.observe(sensors(2), frame, POSE + 0.1)
    third = observer.observe(sensors(4), frame, POSE + 0.2)["state"]
    displacement, imu, action, angles = np.split(third, [9, 21, 57])
    np.testing.assert_allclose(displacement.reshape(3, 3), [[4, 0, 0], [2, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(imu.reshape(3, 4)[:, 2], [4, 2, 1])
    np.testing.assert_allclose(action.reshape(3, 12)[:, 0], [0.2, 0.1, 0.0], atol=1e-6)
    np.testing.assert_allclose(angles.reshape(3, 12)[:, 1], 0.9 + np.array([4, 2, 1]), rtol=1e-6)


def test_roll_and_pitch():
    half = 0.15  # roll 0.3 about x
    rolled = Observer(flat.manifest()).observe(
        sensors(0, quat=np.array([np.cos(half), np.sin(half), 0, 0])), Frame(0.0, np.ones((8, 8))), POSE
    )
    pitched = Observer(flat.manifest()).observe(
        sensors(0, quat=np.array([np.cos(half), 0, np.sin(half), 0])), Frame(0.0, np.ones((8, 8))), POSE
    )
    np.testing.assert_allclose(rolled["state"][9:11], [0.3, 0.0], atol=1e-6)
    np.testing.assert_allclose(pitched["state"][9:11], [0.0, 0.3], atol=1e-6)


def decoded(code):
    return np.expm1((code * 0.425 + 1.25) ** 2)


@pytest.mark.parametrize(("hold", "newest"), [(1, [1, 2, 3, 4, 5, 6]), (4, [1, 1, 1, 1, 5, 5])])
def test_depth_is_stacked_newest_first_and_held(hold, newest):
    observer = Observer(flat.manifest(hold))
    seen = [observer.observe(sensors(0), Frame(0.0, np.full((8, 8), t)), POSE)["depth"] for t in range(1, 7)]
    np.testing.assert_allclose([decoded(stack[3, 4, 0]) for stack in seen], newest, rtol=1e-4)
    np.testing.assert_allclose(decoded(seen[0][0, 0]), [1, 1, 1, 1], rtol=1e-4)
    np.testing.assert_allclose(decoded(seen[4][0, 0]), [5, 4, 3, 2], rtol=1e-4)


def test_stands_runs_and_lies_down(tmp_path):
    robot, seen = MujocoRobot(flat.model(), flat.manifest().camera), []
    assert robot.data.qpos[2] < 0.16

    def policy(obs):
        seen.append((robot.now(), robot.data.qpos[2]))
        return POSE

    record = flat.runner(robot, policy).run(0.8)
    assert record.cause is None
    times = np.array([time for time, _ in seen[1:]])  # the first is the check before the start
    np.testing.assert_allclose(times, 2.4 + 0.04 * np.arange(20), atol=1e-9)
    assert all(height > 0.8 * A1.stand_height for _, height in seen[1:])  # soft gains: the knees give a little
    assert robot.data.qpos[2] < 0.16 and record.misses == 0
    assert record.distance == pytest.approx(0.0, abs=0.05)
    record.save(tmp_path / "run.npz")
    kept = np.load(tmp_path / "run.npz")
    assert kept["state"].shape == (20, 93) and kept["depth"].shape == (20, 8, 8)
    np.testing.assert_allclose(kept["frame_time"], kept["time"], atol=1e-9)
    assert json.loads(str(kept["about"]))["ticks"] == 20


def test_depth_of_a_wall_and_of_the_ground():
    robot = MujocoRobot(flat.model(), flat.manifest().camera, lying=False)
    image = robot.depth().depth
    # The wall's face is at x = 3: planar depth is the same in every pixel that sees it.
    np.testing.assert_allclose(image[2], 3.0 - A1.camera[0], atol=1e-6)
    down = np.tan(np.radians(30)) * (2 * 7 + 1 - 8) / 8  # of the lowest row's ray, per metre ahead
    np.testing.assert_allclose(image[7], A1.stand_height / down, atol=1e-6)


def test_a_collected_sphere_is_gone():
    robot = MujocoRobot(flat.model(), flat.manifest().camera, lying=False)
    for _ in range(16):
        robot.command(POSE, 40.0, 0.6)
    assert robot.model.geom("sphere_0").group != robot.model.geom("ground").group


def test_latency_of_sensors_and_camera():
    faults = Imperfections(sensor_latency=0.02, frame_latency=0.08)
    robot = MujocoRobot(flat.model(), flat.manifest().camera, faults, lying=False)
    for _ in range(80):
        robot.command(POSE, 40.0, 0.6)
    assert robot.read().time == pytest.approx(0.2 - 0.02)
    assert robot.depth().time == pytest.approx(0.2 - 0.08)


BROKEN = {
    "another version": ({"format_version": 99}, f"version 99 {folder.VERSION}"),
    "not a policy": ({"format": "x"}, f"{folder.MANIFEST} policy export"),
    "other inputs": ({"inputs": {"state": flat.raw()["inputs"]["state"]}}, "state depth"),
    "another file": ({"files": {folder.ONNX: {"sha256": "0" * 64}}}, f"{folder.ONNX} {folder.MANIFEST}"),
    "no gains": ({"gains": {}}, "gains kp"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_folder_is_refused(name, tmp_path):
    changes, words = BROKEN[name]
    flat.write(tmp_path, changes)
    with refusal(words):
        Session(folder.read(tmp_path), tmp_path)


def test_missing_files_are_named(tmp_path):
    with refusal(f"{tmp_path}/none export"):
        folder.read(tmp_path / "none")
    flat.write(tmp_path)
    (tmp_path / folder.ONNX).unlink()
    with refusal(f"{tmp_path} {folder.ONNX}"):
        folder.read(tmp_path)


def test_a_policy_that_needs_the_displacement_is_refused_where_there_is_none():
    robot = MujocoRobot(flat.model(), flat.manifest().camera)
    measured = robot.read()
    robot.read = lambda: Sensors(0.0, measured.angles, measured.velocities, measured.quat, measured.gyro)
    with refusal("displacement --env.observation.displacement"):
        flat.runner(robot).run(1.0)


NO_JAX = """
import sys
import loco_mjx.deploy.folder, loco_mjx.deploy.mujoco_robot, loco_mjx.deploy.runner, loco_mjx.deploy.session
from loco_mjx.cli.main import main
code = main(["deploy", sys.argv[1], "--scene", sys.argv[2], "--seconds", "0.2", "--limits.missed", "99"])
print(code, sorted({"jax", "flax", "brax"} & set(sys.modules)))
"""


def test_deploy_runs_from_the_command_line_without_jax(tmp_path):
    policy = flat.write(tmp_path)
    (tmp_path / "scene.xml").write_text(flat.xml())
    words = [sys.executable, "-c", NO_JAX, str(policy), str(tmp_path / "scene.xml")]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"
    assert says(done.stdout, "distance p99")
