"""What goes wrong with a robot: measurements, clocks, images, policies, commands, signals, terminals."""

from __future__ import annotations

import math
import os
import signal
import time

import numpy as np

from experiments.faults.robot_cases import (
    LONG,
    ONE,
    TILTED,
    Case,
    Fault,
    at_fault,
    changed,
    clock,
    command,
    fallen,
    flail,
    frozen,
    late,
    measured,
    policy,
    pressed,
    push,
    raising,
    seen,
    stuck_joint,
)
from loco_mjx.deploy.mujoco_robot import Imperfections
from loco_mjx.deploy.robot import RobotError
from loco_mjx.deploy.safety import Cause, Limits
from tests.deploy import flat
from tests.deploy.faulty import FAULT, Clock, Faulty

SENSORS: dict[str, Fault] = {
    "old measurements": measured(Cause.STALE_SENSORS, changed(time=lambda t: FAULT - 1.0)),
    "measurements of the future": measured(Cause.CLOCK, changed(time=lambda t: t + 1.0)),
    "measurements without a time": measured(Cause.NONFINITE_SENSORS, changed(time=lambda t: math.nan)),
    "a rate is no number": measured(Cause.NONFINITE_SENSORS, changed(gyro=lambda g: g * [1.0, math.nan, 1.0])),
    "the angles are no numbers": measured(Cause.NONFINITE_SENSORS, changed(angles=lambda a: a * math.nan)),
    "infinite speeds": measured(Cause.NONFINITE_SENSORS, changed(velocities=lambda v: np.full(12, math.inf))),
    "the orientation is no number": measured(Cause.NONFINITE_SENSORS, changed(quat=lambda q: q * math.nan)),
    "the place is no number": measured(Cause.NONFINITE_SENSORS, changed(position=lambda p: p * math.nan)),
    "11 angles": measured(Cause.NONFINITE_SENSORS, changed(angles=lambda a: a[:11])),
    "a quaternion of norm 1e-3": measured(Cause.IMPOSSIBLE_SENSORS, changed(quat=lambda q: 1e-3 * q)),
    "a quaternion of norm 0": measured(Cause.IMPOSSIBLE_SENSORS, changed(quat=lambda q: 0.0 * q)),
    "a quaternion of norm 2": measured(Cause.IMPOSSIBLE_SENSORS, changed(quat=lambda q: 2.0 * q)),
    "a joint at 1,000 rad/s": measured(Cause.IMPOSSIBLE_SENSORS, changed(velocities=lambda v: v + 1e3 * ONE)),
    "a joint at -1e6 rad/s": measured(Cause.IMPOSSIBLE_SENSORS, changed(velocities=lambda v: v - 1e6 * ONE)),
    "a trunk at 200 rad/s": measured(Cause.IMPOSSIBLE_SENSORS, changed(gyro=lambda g: np.array([0.0, 0.0, 200.0]))),
    "an angle 1 rad off": measured(Cause.JOINT_LIMIT, changed(angles=lambda a: a + np.eye(12)[0])),
    "an angle 100 rad off": measured(Cause.JOINT_LIMIT, changed(angles=lambda a: a + 100.0 * ONE)),
    "tilted by 69°": fallen(),
    "upside down": measured(Cause.TILT, changed(quat=lambda q: np.array([0.0, 1.0, 0.0, 0.0]))),
    "no answer": measured(Cause.ROBOT, raising(RobotError("no answer"))),
    "no network": measured(Cause.ROBOT, raising(OSError(101, "Network is unreachable"))),
    "a bug of the driver": measured(Cause.FAILURE, raising(ValueError("a packet of 3 bytes"))),
    "all measurements stand still": frozen(
        Cause.STALE_SENSORS, "sensors", "angles", "velocities", "quat", "gyro", "position"
    ),
    "the encoders stand still": frozen(Cause.STALE_SENSORS, "sensors", "angles", "velocities"),
    "the gyroscope stands still": frozen(Cause.STALE_SENSORS, "sensors", "quat", "gyro"),
    "one encoder stands still": stuck_joint,
}
CLOCKS: dict[str, Fault] = {
    "the clock goes back": clock(lambda t: t - 1.0),
    "the clock is no number": clock(lambda t: math.nan),
    "the clock stands still": clock(lambda t: FAULT),
    "the clock jumps ahead": lambda: Case(
        (Cause.STALE_SENSORS,), Clock(lambda t: t + 1.0, sensors=changed(time=lambda t: t - 1.0))
    ),
}
IMAGES: dict[str, Fault] = {
    "old images": seen(Cause.STALE_CAMERA, changed(time=lambda t: FAULT - 1.0)),
    "late images": seen(Cause.STALE_CAMERA, changed(time=lambda t: t - 0.3)),
    "images of the future": seen(Cause.CLOCK, changed(time=lambda t: t + 1.0)),
    "images without a time": seen(Cause.IMPOSSIBLE_IMAGE, changed(time=lambda t: math.nan)),
    "images stand still": frozen(Cause.STALE_CAMERA, "frame", "depth", limits=Limits(frozen=0.2)),
    "images of zeros": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: 0.0 * d)),
    "negative depth": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: d - 100.0)),
    "infinite depth": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: d + math.inf)),
    "depth that is no number": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: d * math.nan)),
    "depth in millimetres": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: (1000 * d).astype(np.uint16))),
    "images of another size": seen(Cause.IMPOSSIBLE_IMAGE, changed(depth=lambda d: d[1:])),
    "no images at all": lambda: Case((Cause.STALE_CAMERA,), Faulty(imperfections=Imperfections(dropped=1.0))),
    "a camera that is unplugged": seen(Cause.ROBOT, raising(RobotError("the camera does not answer"))),
    "a bug of the camera's library": seen(Cause.FAILURE, raising(RuntimeError("frame did not arrive"))),
    "a camera that blocks": seen(Cause.DEADLINE, lambda frame: time.sleep(LONG)),
}
POLICIES: dict[str, Fault] = {
    "the policy raises": policy((Cause.POLICY,), lambda obs: 1 / 0),
    "the policy gives no number": policy((Cause.NONFINITE_ACTION,), lambda obs: np.full(12, math.nan)),
    "the policy gives 11 numbers": policy((Cause.POLICY,), lambda obs: flat.still(obs)[:11]),
    "the policy gives nothing": policy((Cause.POLICY,), lambda obs: None),
    "the policy gives words": policy((Cause.POLICY,), lambda obs: ["a"] * 12),
    "the policy never answers": policy((Cause.DEADLINE,), lambda obs: time.sleep(LONG)),
    "the policy takes 2 s": policy((Cause.DEADLINE,), lambda obs: (time.sleep(2.0), flat.still(obs))[1]),
    "the policy is late every time": late,
    "the policy asks for 1e9 rad": policy(
        (Cause.TORQUE, Cause.TILT, Cause.JOINT_LIMIT, Cause.IMPOSSIBLE_SENSORS), flail
    ),
    "the policy asks for a torque of the limit": policy(
        (Cause.TORQUE, Cause.TILT),
        lambda obs: flat.still(obs) + np.tile([0.0, 3.0, 0.0], 4),
        limits=Limits(saturated=0.02),
    ),
}
COMMANDS: dict[str, Fault] = {
    "one command fails": command((Cause.ROBOT,), OSError(101, "Network is unreachable"), lambda n: n == 0),
    "one command is answered wrongly": command((Cause.ROBOT,), RobotError("no answer"), lambda n: n == 0),
    "one command is refused": command((Cause.FAILURE,), ValueError("bad command"), lambda n: n == 0),
    "every tenth command fails": command((Cause.ROBOT,), OSError(101, "Network is unreachable"), lambda n: n % 10 == 0),
    "every third command is refused": command((Cause.FAILURE,), ValueError("bad command"), lambda n: n % 3 == 0),
    "commands of the sit-down fail": command(
        (Cause.TILT,),
        OSError(101, "Network is unreachable"),
        lambda n: n % 5 == 0,
        sensors=changed(quat=lambda quat: TILTED),
    ),
    "commands of the sit-down are refused": command(
        (Cause.TILT,), ValueError("bad command"), lambda n: n % 5 == 0, sensors=changed(quat=lambda quat: TILTED)
    ),
    "a push": lambda: Case((Cause.TILT,), Faulty(before=push)),
}
OUTSIDE: dict[str, Fault] = {
    name: at_fault(Cause.ESTOP, lambda robot, number=number: os.kill(os.getpid(), number))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
    for name in [number.name]
} | {
    "the emergency stop": pressed,
    "a fall, stdout gone": fallen(say=raising(BrokenPipeError(32, "Broken pipe"))),
    "a fall, stdout full": fallen(say=raising(OSError(28, "No space left on device"))),
    "a fall, stdout stuck": fallen(say=lambda when, text: time.sleep(LONG)),
}
FAULTS: dict[str, Fault] = SENSORS | CLOCKS | IMAGES | POLICIES | COMMANDS | OUTSIDE
