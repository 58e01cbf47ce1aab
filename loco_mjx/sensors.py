"""The sensors of a proprioceptive frame: what each is, and how it is read, in training and on a robot.

A new sensor is one entry here. It is then part of `state` in training, of what ``policy.json`` says of a policy, and of
what a robot's measurements are turned into; a key of its name in ObservationConfig, if there is one, switches it. The
functions are of arrays of either kind: ``xp`` is `jax.numpy` in training and `numpy` on a robot, which has no JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from loco_mjx import rotations
from loco_mjx.robots import NJOINT

Array = Any  # of NumPy or JAX


@dataclass(frozen=True)
class Readings:
    """What sensors are made of: one robot at one moment; in training the first three are delayed by the latency.

    Attributes:
        quat: (4,) unit quaternion of the trunk, (w, x, y, z).
        gyro: (3,) angular velocity in the trunk's frame, rad/s.
        angles: (12,) of the joints, rad.
        last_action: (12,) last joint targets relative to the default pose, rad; None where there are none.
        displacement: (3,) of the base over the last control step, world frame, m; None where its place is not known.
        velocity: (3,) of the trunk, the mean over the last control step, world frame, m/s; None where it is not known.
    """

    quat: Array
    gyro: Array
    angles: Array
    last_action: Array | None
    displacement: Array | None
    velocity: Array | None = None


@dataclass(frozen=True)
class Sensor:
    """A part of every proprioceptive frame.

    Attributes:
        size: numbers per frame.
        unit: of them.
        meaning: in words, for who reads ``policy.json``.
        read: (size,) from (Readings, xp).
    """

    size: int
    unit: str
    meaning: str
    read: Callable[[Readings, Any], Array]


# In the order of the `state` vector.
SENSORS: dict[str, Sensor] = {
    "displacement": Sensor(
        3, "m", "base displacement x, y, z over the last control step, world frame", lambda r, xp: r.displacement
    ),
    "velocity": Sensor(
        3,
        "m/s",
        "velocity of the trunk x, y, z, the mean over the last control step, world frame",
        lambda r, xp: r.velocity,
    ),
    "attitude": Sensor(
        3,
        "rad",
        "roll, pitch, yaw",
        lambda r, xp: xp.concatenate([rotations.roll_pitch(r.quat, xp), rotations.yaw(r.quat, xp)[None]]),
    ),
    "imu": Sensor(
        4,
        "rad, rad, rad/s, rad/s",
        "roll, pitch, roll rate, pitch rate; rates in the trunk's frame",
        lambda r, xp: xp.concatenate([rotations.roll_pitch(r.quat, xp), r.gyro[:2]]),
    ),
    "last_action": Sensor(
        NJOINT,
        "rad",
        "last joint targets minus the default pose, in the order of the joints",
        lambda r, xp: r.last_action,
    ),
    "angles": Sensor(NJOINT, "rad", "joint angles, in the order of the joints", lambda r, xp: r.angles),
}


def in_use(observation: Any) -> dict[str, Sensor]:
    """The sensors of an ObservationConfig, in the order of the `state` vector."""
    return {name: sensor for name, sensor in SENSORS.items() if getattr(observation, name, True)}


def measure(readings: Readings, names: Iterable[str], xp: Any) -> dict[str, Array]:
    """One frame of the sensors of these names, (size,) each."""
    return {name: SENSORS[name].read(readings, xp) for name in names}
