"""Every fault ends the run with its cause and with the robot lying down, softly; no command before every check."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from loco_mjx.deploy.estop import SIGNALS, EmergencyStop
from loco_mjx.deploy.mujoco_robot import Imperfections, MujocoRobot
from loco_mjx.deploy.robot import RobotError
from loco_mjx.deploy.safety import Cause, Guard, Limits, Stop
from loco_mjx.errors import UserError
from loco_mjx.robots.motor import MotorCommand
from tests.deploy import flat
from tests.deploy.faulty import FAULT, Faulty, lies
from tests.known_robots import A1
from tests.refusals import refusal, says


def stopped(robot, cause, **more):
    record = flat.runner(robot, **more).run(1.0)
    assert record.cause == cause
    assert record.events[-2][1].startswith(cause)
    assert robot.commands[-1][1] == 0.0  # limp in the end, damped all along
    after = [kd for _, _, kd in robot.commands[-100:]]
    assert min(after) >= 2.0
    assert 2 <= len(record.rows) < 25
    return record


def silent(sensors):
    raise RobotError("no answer")


SENSOR_FAULTS = {
    Cause.STALE_SENSORS: lambda s: replace(s, time=FAULT - 1.0),
    Cause.NONFINITE_SENSORS: lambda s: replace(s, gyro=np.array([0.0, np.nan, 0.0])),
    Cause.TILT: lambda s: replace(s, quat=np.array([np.cos(0.6), np.sin(0.6), 0.0, 0.0])),
    Cause.JOINT_LIMIT: lambda s: replace(s, angles=s.angles + np.eye(12)[0]),
    Cause.ROBOT: silent,
}


@pytest.mark.parametrize("cause", SENSOR_FAULTS)
def test_sensor_faults(cause):
    robot = Faulty(sensors=SENSOR_FAULTS[cause])
    stopped(robot, cause)
    assert lies(robot)


def test_a_camera_that_stands_still():
    robot = Faulty(frame=lambda frame: replace(frame, time=FAULT - 1.0))
    stopped(robot, Cause.STALE_CAMERA)
    assert lies(robot)


def test_an_action_that_is_no_number():
    robot = Faulty()
    robot_policy = lambda obs: np.full(12, np.nan) if robot.broken else flat.still(obs)  # noqa: E731
    stopped(robot, Cause.NONFINITE_ACTION, policy=robot_policy)
    assert lies(robot)
    assert all(np.all(np.isfinite(targets)) for targets, _, _ in robot.commands)


def test_an_exception_of_the_policy_is_a_fault():
    robot = Faulty()
    record = stopped(robot, Cause.POLICY, policy=lambda obs: 1 / 0 if robot.broken else flat.still(obs))
    assert says(record.detail, "ZeroDivisionError")
    assert lies(robot)


def test_missed_deadlines():
    robot, reading = Faulty(), iter(range(10_000))
    clock = lambda: 0.05 * next(reading) if robot.broken else 0.0  # noqa: E731
    record = stopped(robot, Cause.DEADLINE, clock=clock, limits=Limits(missed=3))
    assert record.misses == 3


def test_a_deadline_missed_now_and_then_is_only_counted():
    guard = Guard(flat.manifest(), Limits(missed=3))
    for latency in (0.05, 0.05, 0.01) * 4:
        guard.deadline(latency, 0.04)
    assert guard.misses == 8


def test_torque_asked_for_too_long():
    robot = Faulty()
    far = np.array(A1.default_pose) + np.tile([0.0, 3.0, 0.0], 4)
    kick = lambda obs: far if robot.broken else flat.still(obs)  # noqa: E731
    record = stopped(robot, Cause.TORQUE, policy=kick, limits=Limits(saturated=0.021))
    assert record.clamped >= 8


@pytest.mark.parametrize("number", SIGNALS)
def test_emergency_stop_by_signal(number):
    sent = []
    robot = Faulty(before=lambda robot: sent or (sent.append(1), os.kill(os.getpid(), number)))
    before = signal.getsignal(number)
    record = stopped(robot, Cause.ESTOP)
    assert record.detail == signal.Signals(number).name
    assert lies(robot)
    assert signal.getsignal(number) is before


def test_emergency_stop_before_the_start_commands_nothing():
    robot, estop = Faulty(), EmergencyStop()
    estop.press("test")
    record = flat.runner(robot, estop=estop).run(1.0)
    assert (record.cause, robot.commands) == (Cause.ESTOP, [])


def test_a_real_fall_is_noticed():
    def push(robot):
        robot.data.xfrc_applied[1, 3] = 40.0  # N·m about x

    record = stopped(Faulty(before=push), Cause.TILT)
    assert record.rows[-1]["up"] > Limits().min_up


def test_dropped_frames_are_borne_until_they_are_too_many():
    robot = Faulty(imperfections=Imperfections(dropped=0.4), seed=1)
    assert flat.runner(robot, limits=Limits(frame_age=0.5)).run(0.4).cause is None
    with refusal("imperfections.frame_latency 0.5 0 0.2"):
        Faulty(imperfections=Imperfections(frame_latency=0.5))
    never = Faulty(imperfections=Imperfections(dropped=1.0))
    assert flat.runner(never).run(0.4).cause == Cause.STALE_CAMERA


def test_clamps():
    guard, robot = Guard(flat.manifest(), Limits()), Faulty(lying=False)
    sensors = replace(robot.read(), velocities=np.linspace(-3, 3, 12))
    far = np.array(A1.default_pose) + np.tile([5.0, -5.0, 5.0], 4)
    safe = guard.clamp(far, sensors, 40.0, 0.6)
    torque = 40.0 * (safe - sensors.angles) - 0.6 * sensors.velocities
    assert np.abs(torque).max() <= A1.torque_limit[0] + 1e-9
    assert np.all(safe <= np.array(A1.upper) + 1e-9) and np.all(safe >= np.array(A1.lower) - 1e-9)
    assert guard.clamped == 1
    np.testing.assert_array_equal(guard.clamp(sensors.angles, sensors, 40.0, 0.6), sensors.angles)


@pytest.mark.parametrize("name", ["read", "depth", "stale", "tilted", "small"])
def test_never_commanded_before_every_check_has_passed(name):
    robot = Faulty()
    sensors, frame = robot.read(), robot.depth()
    if name in ("read", "depth"):
        setattr(robot, name, lambda: silent(None))
    robot.read = {
        "stale": lambda: replace(sensors, time=-1.0),
        "tilted": lambda: replace(sensors, quat=np.array([0.0, 1.0, 0.0, 0.0])),
    }.get(name, robot.read)
    if name == "small":
        robot.depth = lambda: replace(frame, depth=frame.depth[1:])
    with pytest.raises(UserError):
        flat.runner(robot).run(1.0)
    assert robot.commands == []


def test_stop_names_its_cause():
    assert says(str(Stop(Cause.TILT, "70°")), f"{Cause.TILT} 70°")


def test_a_torque_asked_for_counts_for_as_long_as_it_is_held():
    """Commands twice as far apart as they should be: the time counts, not their number."""
    guard, far = Guard(flat.manifest(), Limits(saturated=0.1)), np.array(A1.default_pose) + 3.0
    measured = MujocoRobot(flat.model(), None).read()
    spacing, given = 2 * A1.physics_dt, 0
    with pytest.raises(Stop, match="torque limit"):
        for given in range(100):
            angles = measured.angles + 1e-4 * given
            now = replace(measured, time=given * spacing, angles=angles)
            guard.clamp(np.clip(far, A1.lower, A1.upper), now, 40.0, 0.6)
    assert given * spacing == pytest.approx(0.1, abs=2 * spacing)


def test_motors_are_told_nothing_that_is_no_number():
    measured = MujocoRobot(flat.model(), None).read()
    good = MotorCommand(measured.angles, *(np.zeros(12) for _ in range(4)))
    guard = Guard(flat.manifest(), Limits())
    guard.motors(good, measured)
    for name in good._fields:
        with pytest.raises(Stop, match="non-finite action"):
            guard.motors(good._replace(**{name: np.full(12, np.nan)}), measured)
