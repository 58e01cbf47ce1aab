"""Which measurements a robot with a depth camera can give, and which no robot can."""

from __future__ import annotations

import numpy as np

from loco_mjx.deploy.folder import Camera
from loco_mjx.deploy.robot import Frame, Sensors
from loco_mjx.robots import NJOINT

JOINT_SPEED = 60.0  # rad/s; the motors reach 21, an impact a little more
TRUNK_SPEED = 35.0  # rad/s, the gyroscope's range, 2000 °/s
NORM = 0.1  # by which a quaternion's norm may differ from 1
MOVED = 0.05  # rad; a joint whose target has moved by more does not stay where it is to the last bit
SHAPES = {"angles": NJOINT, "velocities": NJOINT, "quat": 4, "gyro": 3}


def malformed(sensors: Sensors) -> str | None:
    """What of the measurements is no number, or not as many as it should be; None if nothing."""
    for name, size in SHAPES.items():
        value = np.asarray(getattr(sensors, name))
        if value.shape != (size,):
            return f"{name} of shape {value.shape}, not {(size,)}"
        if not np.all(np.isfinite(value)):
            return f"{name}: a measurement is not a number"
    if sensors.position is not None and not np.all(np.isfinite(sensors.position)):
        return "position: a measurement is not a number"
    return None if np.isfinite(sensors.time) else f"the time of a measurement is {sensors.time}"


def impossible(sensors: Sensors, joints: tuple[str, ...]) -> str | None:
    """What of finite measurements no such robot can do; None if it can do all of it."""
    norm = float(np.linalg.norm(sensors.quat))
    if abs(norm - 1) > NORM:
        return f"the orientation's quaternion has norm {norm:.3g}; accepted: 1 ± {NORM}"
    worst = int(np.argmax(np.abs(sensors.velocities)))
    if abs(sensors.velocities[worst]) > JOINT_SPEED:
        return f"{joints[worst]} at {sensors.velocities[worst]:.3g} rad/s; accepted: up to {JOINT_SPEED}"
    speed = float(np.abs(sensors.gyro).max())
    if speed > TRUNK_SPEED:
        return f"the trunk turns at {speed:.3g} rad/s; accepted: up to {TRUNK_SPEED}"
    return None


def unusable(frame: Frame, camera: Camera | None) -> str | None:
    """Why an image is none of the policy's camera; None if it is one."""
    depth = np.asarray(frame.depth)
    if camera is not None and depth.shape != (camera.height, camera.width):
        return f"the camera gives {depth.shape} images, the policy reads {camera.height, camera.width}"
    if depth.dtype.kind != "f":
        return f"the camera gives {depth.dtype} numbers; accepted: floating point, in metres"
    if not np.all(np.isfinite(depth)):
        return "a depth is not a number"
    if np.any(depth <= 0):
        return f"a depth is {depth.min():.3g} m; accepted: more than 0, and the far clip where nothing was measured"
    return None if np.isfinite(frame.time) else f"the time of an image is {frame.time}"


class Unchanged:
    """For how long a measurement has stayed the same to the last bit, which no sensor's does."""

    def __init__(self) -> None:
        """Has seen nothing yet."""
        self._value: np.ndarray | None = None
        self._since = 0.0

    def seconds(self, value: np.ndarray, when: float) -> float:
        """Takes in a measurement of a time, s."""
        if self._value is None or not np.array_equal(value, self._value):
            self._value, self._since = value.copy(), when
        return when - self._since


class Stuck:
    """For how long each joint has measured the same to the last bit while its target moved: an encoder that is stuck.

    A joint that holds a pose may well measure the same; one that is to go elsewhere does not.
    """

    def __init__(self) -> None:
        """Has seen nothing yet."""
        self._measured = np.full((2, NJOINT), np.nan)
        self._since, self._low, self._high = np.zeros(NJOINT), np.zeros(NJOINT), np.zeros(NJOINT)

    def seconds(self, sensors: Sensors, targets: np.ndarray) -> np.ndarray:
        """(12,) s, 0 where the target has not moved; takes in a measurement and (12,) targets, rad."""
        measured = np.stack([sensors.angles, sensors.velocities])
        same = np.all(measured == self._measured, axis=0)
        self._measured = measured
        self._since = np.where(same, self._since, sensors.time)
        self._low = np.where(same, np.minimum(self._low, targets), targets)
        self._high = np.where(same, np.maximum(self._high, targets), targets)
        return np.where(self._high - self._low > MOVED, sensors.time - self._since, 0.0)
