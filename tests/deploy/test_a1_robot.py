"""What is sent to the A1's motors and read from its packets: order, units, gains, pace. The SDK is a stand-in.

It has the names and the layout of unitree_legged_sdk's Python binding, and answers, as the robot does, only who speaks
to it. That a robot does with these packets what it should is beyond any test here; docs/deployment.md says so.
"""

from __future__ import annotations

import subprocess
import sys
import time
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.deploy.a1_robot import NO_POSITION, A1Robot
from loco_mjx.deploy.robot import RobotError
from tests.deploy import flat
from tests.known_robots import A1
from tests.refusals import refusal, says

ANGLES = np.array(A1.default_pose) + 0.01 * np.arange(12)


class Udp:
    """Keeps what is sent; each packet sent is answered by one with the robot's state."""

    def __init__(self, *address):
        self.address, self.sent, self.times, self.ticks, self.mute = address, [], [], 0, False
        self.pressed = None  # on the feet's sensors, where there are some
        Udp.last = self

    def InitCmdData(self, command):  # noqa: N802
        command.ready = True

    def SetSend(self, command):  # noqa: N802
        assert command.ready
        motors = command.motorCmd
        self.sent.append([(m.mode, m.q, m.dq, m.Kp, m.Kd, m.tau) for m in motors[:12]])

    def Send(self):  # noqa: N802
        self.times.append(time.monotonic())
        self.ticks += 0 if self.mute else 2000

    def Recv(self):  # noqa: N802
        pass

    def GetRecv(self, state):  # noqa: N802
        state.tick = self.ticks
        if self.ticks:
            for i, motor in enumerate(state.motorState[:12]):
                motor.q, motor.dq = float(ANGLES[i]), 0.1 * i
            if self.pressed is not None:
                state.footForce = self.pressed
            state.imu = SimpleNamespace(quaternion=[0.8, 0.6, 0.0, 0.0], gyroscope=[0.1, 0.2, 0.3])


def _motors():
    return [SimpleNamespace(mode=0, q=0.0, dq=0.0, Kp=0.0, Kd=0.0, tau=0.0) for _ in range(20)]


@pytest.fixture
def sdk(monkeypatch, tmp_path):
    monkeypatch.setattr("loco_mjx.deploy.lock.FOLDER", tmp_path)
    module = ModuleType("robot_interface")
    module.limited = 0

    class Safety:
        def __init__(self, kind):
            assert kind == "A1"

        def PositionLimit(self, command):  # noqa: N802
            module.limited += 1

    module.UDP, module.Safety, module.LeggedType = Udp, Safety, SimpleNamespace(A1="A1")
    module.LowCmd = lambda: SimpleNamespace(motorCmd=_motors(), ready=False)
    module.LowState = lambda: SimpleNamespace(motorState=_motors(), imu=None, tick=0)
    monkeypatch.setitem(sys.modules, "robot_interface", module)
    return module


def test_connecting_asks_for_no_torque(sdk):
    A1Robot(None)
    assert Udp.last.address == (0xFF, 8080, "192.168.123.10", 8007)
    assert Udp.last.sent
    for packet in Udp.last.sent:
        assert all(motor == (0x0A, NO_POSITION, 16000.0, 0.0, 0.0, 0.0) for motor in packet)


def test_measurements(sdk):
    sensors = A1Robot(None).read()
    np.testing.assert_allclose(sensors.angles, ANGLES)
    np.testing.assert_allclose(sensors.velocities, 0.1 * np.arange(12))
    np.testing.assert_allclose(sensors.quat, [0.8, 0.6, 0.0, 0.0])
    np.testing.assert_allclose(sensors.gyro, [0.1, 0.2, 0.3])
    assert sensors.position is None


def test_feet_touch_when_their_sensors_are_pressed(sdk):
    robot = A1Robot(None)
    assert robot.read().feet is None  # a binding without foot sensors
    Udp.last.pressed = [0, 19, 21, 150]
    assert robot.read().feet.tolist() == [False, False, True, True]


def test_driving_reaches_every_motor_with_its_own_gains_and_torque(sdk):
    robot, rows = A1Robot(None), np.arange(60.0).reshape(5, 12)
    robot.drive(*rows)
    angles, velocities, kp, kd, torque = rows
    wanted = [(0x0A, *map(float, motor)) for motor in zip(angles, velocities, kp, kd, torque, strict=True)]
    assert Udp.last.sent[-1] == wanted and sdk.limited == 1


def test_commands_reach_the_motors_in_order(sdk):
    robot = A1Robot(None)
    targets = np.linspace(-1.0, 1.0, 12)
    robot.command(targets, 40.0, 0.6)
    assert sdk.limited == 1
    np.testing.assert_allclose(Udp.last.sent[-1], [(0x0A, q, 0.0, 40.0, 0.6, 0.0) for q in targets])
    robot.close()
    assert all(motor[3:] == (0.0, 0.0, 0.0) for motor in Udp.last.sent[-1])


def test_commands_are_no_faster_than_400_hz(sdk):
    robot = A1Robot(None)
    begin, count = len(Udp.last.times), 40
    for _ in range(count + 1):
        robot.command(ANGLES, 40.0, 0.6)
    took = Udp.last.times[-1] - Udp.last.times[begin]
    assert took >= (count - 1) * A1.physics_dt


def test_it_is_spoken_to_while_nothing_is_commanded(sdk):
    """A camera that opens, a policy that thinks: what is measured is of now, and nothing new is asked of the motors."""
    robot = A1Robot(None)
    for command in (None, ANGLES):
        if command is not None:
            robot.command(command, 40.0, 0.6)
        last = Udp.last.sent[-1]
        time.sleep(0.1)
        begin = robot.now()
        assert robot.read().time >= begin  # not of before the pause
        assert Udp.last.sent[-1] == last


class Time:
    """A clock that goes on by what is slept, and by what is worked."""

    now = 100.0

    def sleep(self, seconds):
        assert seconds >= 0
        self.now += seconds


@pytest.mark.parametrize("work", [0.001, 0.003, 0.0045])
def test_ticks_of_five_milliseconds_take_that_long_whatever_part_of_it_is_work(sdk, monkeypatch, work):
    """What the whole-body controller does: it works, then commands until the next tick; no two packets at once."""
    clock = Time()
    monkeypatch.setattr(
        "loco_mjx.deploy.a1_robot.time", SimpleNamespace(monotonic=lambda: clock.now, sleep=clock.sleep)
    )
    robot, sent = A1Robot(None), []
    monkeypatch.setattr(Udp, "Send", lambda self: sent.append(clock.now))
    due = begin = clock.now
    for _ in range(100):
        clock.sleep(work)
        due = max(due + 0.005, clock.now)
        while True:
            robot.command(ANGLES, 40.0, 0.6)
            if clock.now > due - 0.5 * A1.physics_dt:
                break
    assert (clock.now - begin) / 100 == pytest.approx(0.005, rel=0.03)
    assert np.diff(sent).min() > A1.physics_dt - 1e-6


def test_the_pace_is_kept_after_a_pause(sdk):
    robot = A1Robot(None)
    robot.command(ANGLES, 40.0, 0.6)
    time.sleep(0.05)
    begin = len(Udp.last.times)
    for _ in range(3):
        robot.command(ANGLES, 40.0, 0.6)
    assert np.diff(Udp.last.times[begin:]).min() > 0.9 * A1.physics_dt


def test_of_several_packets_the_last_one_counts(sdk, monkeypatch):
    """Those of a pause lie in the socket, one behind the other."""
    robot, waiting = A1Robot(None), [6000, 8000, 10_000]
    monkeypatch.setattr(Udp, "Recv", lambda self: waiting and setattr(self, "ticks", waiting.pop(0)))
    robot.read()
    assert not waiting


def test_a_robot_that_falls_silent_grows_old(sdk):
    robot = A1Robot(None)
    first = robot.read().time
    robot.command(ANGLES, 40.0, 0.6)
    second = robot.read().time
    assert second > first
    Udp.last.mute = True
    for _ in range(5):
        robot.command(ANGLES, 40.0, 0.6)
    assert robot.read().time == second


def test_a_robot_that_does_not_answer_is_not_commanded(sdk, monkeypatch):
    monkeypatch.setattr("loco_mjx.deploy.a1_robot.CONNECT", 0.05)
    monkeypatch.setattr(Udp, "Send", lambda self: None)
    with refusal("robot answer network"):
        A1Robot(None)
    assert all(motor[3] == 0.0 for packet in Udp.last.sent for motor in packet)


def test_there_is_no_depth_without_a_camera(sdk):
    with refusal("camera", RobotError):
        A1Robot(None).depth()


def test_policies_it_cannot_feed_are_refused_before_it_is_spoken_to(sdk, tmp_path, capsys):
    Udp.last = None
    flat.write(tmp_path)
    assert main(["deploy", str(tmp_path), "--robot", "a1"]) == 2
    assert says(capsys.readouterr().err, "displacement --env.observation.displacement False")
    goal = flat.raw(displacement=False, goal=True)
    flat.write(tmp_path, {name: part for name, part in goal.items() if name != "files"})
    assert main(["deploy", str(tmp_path), "--robot", "a1"]) == 2
    assert says(capsys.readouterr().err, "goal --env.observation.goal False")
    assert Udp.last is None


def test_without_the_sdk(monkeypatch):
    monkeypatch.setitem(sys.modules, "robot_interface", None)
    with refusal("unitree_legged_sdk"):
        A1Robot(None)


HOLDER = """
import sys, time
from pathlib import Path
from loco_mjx.deploy import lock
lock.FOLDER = Path(sys.argv[1])
held = lock.Lock("a1-192.168.123.10")
print("held", flush=True)
time.sleep(60)
"""


def test_a_second_runner_is_refused_until_the_first_is_dead(sdk, tmp_path):
    Udp.last = None
    words = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as first:
        assert first.stdout.readline() == "held\n"
        with refusal("another robot locked"):
            A1Robot(None)
        assert Udp.last is None  # its motors did not go limp
        first.kill()
    A1Robot(None).close()
    A1Robot(None).close()
