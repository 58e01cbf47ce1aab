"""The sit-down runs whatever breaks beside it: the terminal, single commands, the policy that never answers."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from loco_mjx.deploy.safety import Cause, Limits
from tests.deploy import flat
from tests.deploy.faulty import Faulty, lies
from tests.deploy.test_safety import stopped
from tests.refusals import says

TILTED = np.array([np.cos(0.6), np.sin(0.6), 0.0, 0.0])


def fallen(**more):
    return Faulty(sensors=lambda s: replace(s, quat=TILTED), **more)


def gone(when, text):
    raise BrokenPipeError(32, "Broken pipe")


@pytest.mark.parametrize("say", [gone, lambda when, text: time.sleep(60)], ids=["gone", "stuck"])
def test_without_a_terminal(say):
    robot = fallen()
    stopped(robot, Cause.TILT, say=say)
    assert lies(robot)


@pytest.mark.parametrize("error", [OSError(101, "Network is unreachable"), ValueError("bad command")])
def test_commands_that_fail_during_it(error):
    failed = []

    def fail(robot):
        if len(failed) < 20 and len(robot.commands) % 10 == 0:
            failed.append(1)
            robot.commands.append((None, 0.0, 9.0))
            raise error

    robot = fallen(before=fail)
    stopped(robot, Cause.TILT)
    assert len(failed) == 20 and lies(robot)


def test_a_command_that_fails_while_running():
    failed = []

    def fail(robot):
        if not failed:
            failed.append(1)
            raise OSError(101, "Network is unreachable")

    record = stopped(Faulty(before=fail), Cause.ROBOT)
    assert "unreachable" in record.detail


IMAGES = {
    "shape": (lambda depth: depth[1:], "(7, 8)"),
    "negative": (lambda depth: depth - 100.0, "0"),
    "millimetres": (lambda depth: (1000 * depth).astype(np.uint16), "uint16"),
    "no number": (lambda depth: depth * np.nan, "number"),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images_of_no_camera(name):
    change, words = IMAGES[name]
    robot = Faulty(frame=lambda frame: replace(frame, depth=change(frame.depth)))
    record = stopped(robot, Cause.IMPOSSIBLE_IMAGE)
    assert says(record.detail, words) and lies(robot)


def test_an_inference_that_does_not_end():
    never, robot = threading.Event(), Faulty()
    begin = []

    def policy(obs):
        if robot.broken:
            begin.append(time.monotonic())
            never.wait(60)
        return flat.still(obs)

    stopped(robot, Cause.DEADLINE, policy=policy, limits=Limits(missed=3))
    assert time.monotonic() - begin[0] < 20 and lies(robot)
    never.set()


def test_a_slow_inference_is_not_waited_for():
    robot, lying = Faulty(), []

    def policy(obs):
        if robot.broken:
            time.sleep(2.0)
            lying.append(lies(robot))
        return flat.still(obs)

    record = stopped(robot, Cause.DEADLINE, policy=policy)
    assert says(record.detail, "ended")
