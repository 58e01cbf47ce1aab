"""Clocks that jump, measurements that stand still, and limits that would never end a run."""

import math
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.deploy.safety import Cause, Guard, Limits, Stop
from tests.deploy import flat
from tests.deploy.faulty import FAULT, Clock, Faulty, lies
from tests.deploy.test_safety import stopped
from tests.refusals import refusal, says

JOINTS = ("angles", "velocities")
JUMPS = {"back": lambda t: t - 1.0, "no number": lambda t: math.nan, "still": lambda t: FAULT}


@pytest.mark.parametrize("name", JUMPS)
def test_clocks(name):
    robot = Clock(JUMPS[name])
    record = flat.runner(robot).run(1.0)
    assert record.cause == Cause.CLOCK and lies(robot)
    assert robot.commands[-1][1] == 0.0


def test_measurements_of_the_future():
    stopped(Faulty(sensors=lambda s: replace(s, time=s.time + 1.0)), Cause.CLOCK)
    stopped(Faulty(frame=lambda f: replace(f, time=f.time + 1.0)), Cause.CLOCK)


def test_an_image_without_a_time():
    stopped(Faulty(frame=lambda f: replace(f, time=np.nan)), Cause.IMPOSSIBLE_IMAGE)


@pytest.mark.parametrize(
    "names", [("angles", "velocities"), ("quat", "gyro"), ("angles", "velocities", "quat", "gyro")]
)
def test_measurements_that_stand_still(names):
    kept = []

    def freeze(sensors):
        kept.append(sensors)
        return replace(sensors, **{name: getattr(kept[0], name) for name in names})

    robot = Faulty(sensors=freeze)
    record = stopped(robot, Cause.STALE_SENSORS, limits=Limits(frozen=0.2))
    assert says(record.detail, "joints" if "angles" in names else "orientation") and lies(robot)


def test_one_encoder_that_stands_still_while_the_others_go_on():
    knee, kept, ticks = np.arange(12) == 5, [], count()

    def stick(sensors):
        kept.append(sensors)
        stuck = {name: np.where(knee, getattr(kept[0], name), getattr(sensors, name)) for name in JOINTS}
        return replace(sensors, **stuck)

    def sway(obs):
        return flat.still(obs) + 0.1 * math.sin(next(ticks)) * np.tile([0.0, 1.0, -1.0], 4)

    robot = Faulty(sensors=stick)
    record = stopped(robot, Cause.STALE_SENSORS, policy=sway, limits=Limits(frozen=0.2))
    assert says(record.detail, "FL_calf_joint") and lies(robot)
    assert flat.runner(Faulty(), policy=sway, limits=Limits(frozen=0.2)).run(1.0).cause is None


def test_a_joint_that_is_to_stay_may_measure_the_same():
    guard, sensors = Guard(flat.manifest(), Limits()), Faulty(lying=False).read()
    for tick in range(20):
        guard.clamp(sensors.angles, replace(sensors, time=0.1 * tick), 40.0, 0.6)
    with refusal("target", Stop):
        guard.clamp(sensors.angles + 0.06, sensors=replace(sensors, time=2.0), kp=40.0, kd=0.6)


def test_images_that_stand_still():
    kept = []

    def freeze(frame):
        kept.append(frame)
        return replace(frame, depth=kept[0].depth)

    record = stopped(Faulty(frame=freeze), Cause.STALE_CAMERA, limits=Limits(frozen=0.1))
    assert says(record.detail, "image")


def test_nothing_in_sight_may_stay_so():
    robot = Faulty(frame=lambda frame: replace(frame, depth=np.full((8, 8), 10.0)))
    assert flat.runner(robot, limits=Limits(frozen=0.1)).run(1.5).cause is None


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -1.0])
@pytest.mark.parametrize("name", ["min_up", "joint_margin", "saturated", "sensor_age", "frame_age", "frozen"])
def test_limits_that_are_none(name, value, capsys):
    with refusal(f"limits.{name} {value}"):
        flat.runner(Faulty(), limits=Limits(**{name: value}))
    assert main(["deploy", "policy", f"--limits.{name.replace('_', '-')}", str(value)]) == 2
    shown = capsys.readouterr()
    assert says(shown.err, f"limits.{name} {value}") and len(shown.err.splitlines()) == 1


def test_an_upright_that_cannot_be():
    with refusal("limits.min_up 1.0 1"):
        flat.runner(Faulty(), limits=Limits(min_up=1.0))
