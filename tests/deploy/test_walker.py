"""The whole-body controller on C MuJoCo's A1, through the deployment's loop and its guard."""

import subprocess
import sys

import numpy as np
import pytest

from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.safety import Cause, Limits
from loco_mjx.deploy.walker import Walker
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import controller, library
from loco_mjx.whole_body.config import WholeBodyConfig
from tests.deploy import flat
from tests.known_robots import A1
from tests.refusals import refusal, says

pytest.importorskip("quadprog")  # the extra `mpc`


def walker(wanted=lambda time: (0.3, 0.2), robot=None, **more):
    return Walker(A1, wanted, robot or MujocoRobot(flat.model(), None), clock=flat.clock, patience=5.0, **more)


def texts(record):
    return [text for _, text in record.events]


def test_it_stands_up_walks_and_sits_down():
    run = walker()
    record = run.run(2.0)
    assert record.cause is None and texts(record) == ["standing up", "running", "sitting down", "done"]
    assert record.distance == pytest.approx(0.55, abs=0.12) and run.unsolved == 0 and run.clipped == 0
    rows = record.rows
    assert len(rows) >= 400 and np.allclose(np.diff([row["time"] for row in rows[:400]]), 0.005)
    assert not all(row["pushes"].all() for row in rows)
    data = run.robot.data
    assert data.qpos[2] < 0.15 and 1 - 2 * (data.qpos[4] ** 2 + data.qpos[5] ** 2) > 0.95  # it sits, upright


def test_commands_beyond_the_limits_are_clipped_and_said_once():
    run = walker(lambda time: (2.0, 0.0))
    record = run.run(0.3)
    assert record.cause is None and run.clipped == 60
    (said,) = [text for text in texts(record) if "clipped" in text]
    assert says(said, "2 m/s 0.4")


def failing(after, times):
    """A solver that fails so often, after so many programs."""
    solve, count = library.make_solver(WholeBodyConfig().mpc), 0

    def maybe(program):
        nonlocal count
        count += 1
        fails = after < count <= after + times
        return (
            controller.Solution(np.full((10, 4, 3), np.nan), np.bool_(False), np.int32(0)) if fails else solve(program)
        )

    return maybe


def test_a_few_failures_are_counted_and_walked_over():
    run = walker(solve=failing(100, 4))
    record = run.run(1.0)
    assert record.cause is None and run.unsolved == 4


def test_failures_in_a_row_end_in_a_damped_sit_down():
    run = walker(solve=failing(100, 1000), limits=Limits(unsolved=3))
    record = run.run(3.0)
    assert record.cause == Cause.SOLVER and says(record.detail, "3") and run.unsolved == 3
    assert run.robot.data.qpos[2] < 0.2 and np.abs(run.robot.data.qvel[:3]).max() < 0.2


def test_torques_are_kept_within_the_motors_limits():
    run = walker()
    sensors, of_each = run.robot.read(), np.ones(12)
    safe = run.guard.motors(
        MotorCommand(0.9 * sensors.angles, 0 * of_each, 50 * of_each, of_each, 200 * of_each), sensors
    )
    asked = safe.torque + safe.kp * (safe.angles - sensors.angles) - safe.kd * sensors.velocities
    np.testing.assert_allclose(asked, 33.5)
    assert run.guard.clamped == 1


def test_a_robot_without_feeling_in_its_feet_is_refused():
    robot = MujocoRobot(flat.model(), None)
    blind = robot.read
    robot.read = lambda: type(blind())(**(vars(blind()) | {"feet": None}))
    with refusal("feet"):
        walker(robot=robot).run(1.0)


def test_it_needs_no_jax(tmp_path):
    (tmp_path / "scene.xml").write_text(flat.xml())
    code = "import sys; sys.modules['jax'] = None; from loco_mjx.cli.main import main; sys.exit(main(sys.argv[1:]))"
    words = ["deploy", "--controller", "mpc", "--vx", "0.3", "--seconds", "0.2", "--limits.missed", "100"]
    command = [sys.executable, "-c", code, *words, "--scene", str(tmp_path / "scene.xml")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
