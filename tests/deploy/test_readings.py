"""Readings that no A1 can give end the run, and whatever is read, no command is beyond the joints' limits."""

from dataclasses import replace

import numpy as np
import pytest

from loco_mjx.deploy.safety import Cause, Guard, Limits
from tests.deploy import flat
from tests.deploy.faulty import Faulty, lies
from tests.deploy.test_safety import stopped
from tests.known_robots import A1

ONE = np.eye(12)[2]


def within(targets):
    return np.all(targets >= np.array(A1.lower) - 1e-9) and np.all(targets <= np.array(A1.upper) + 1e-9)


IMPOSSIBLE = {
    "fast joint": lambda s: replace(s, velocities=s.velocities + 1000.0 * ONE),
    "very fast joint": lambda s: replace(s, velocities=s.velocities - 1e6 * ONE),
    "fast trunk": lambda s: replace(s, gyro=np.array([0.0, 0.0, 200.0])),
    "short quaternion": lambda s: replace(s, quat=1e-3 * s.quat),
    "long quaternion": lambda s: replace(s, quat=2.0 * s.quat),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_impossible_readings(name):
    robot = Faulty(sensors=IMPOSSIBLE[name])
    stopped(robot, Cause.IMPOSSIBLE_SENSORS)
    assert lies(robot)
    assert all(within(targets) for targets, _, _ in robot.commands)


MALFORMED = {
    "infinite": lambda s: replace(s, velocities=s.velocities + np.inf * (1 + ONE)),
    "too few": lambda s: replace(s, angles=s.angles[:11]),
    "nowhere": lambda s: replace(s, position=np.full(3, np.nan)),
    "no time": lambda s: replace(s, time=np.nan),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_readings_that_are_no_numbers(name):
    robot = Faulty(sensors=MALFORMED[name])
    stopped(robot, Cause.NONFINITE_SENSORS)
    assert lies(robot)


def test_a_joint_far_beyond_its_limits():
    robot = Faulty(sensors=lambda s: replace(s, angles=s.angles + 100.0 * ONE))
    stopped(robot, Cause.JOINT_LIMIT)
    assert all(within(targets) for targets, _, _ in robot.commands)


@pytest.mark.parametrize("speed", [30.0, 1000.0, -1000.0, 1e6])
def test_the_joints_limits_hold_whatever_the_speed(speed):
    guard, sensors = Guard(flat.manifest(), Limits()), Faulty(lying=False).read()
    assert within(guard.clamp(sensors.angles, replace(sensors, velocities=speed * np.ones(12)), 40.0, 0.6))
