"""How fast a robot goes that does not know: from the legs that stand."""

from __future__ import annotations

from loco_mjx.controllers import TICK
from loco_mjx.whole_body import legs
from loco_mjx.whole_body.arrays import Array, space
from loco_mjx.whole_body.legs import Body

SMOOTHING = 0.03  # s, time constant of the low-pass filter on what the legs say


def velocity(body: Body, angles: Array, speeds: Array, gyro: Array, stands: Array, before: Array) -> Array:
    """(3,) velocity of the trunk in its own frame, m/s.

    A foot that stands does not move, so the trunk goes as the foot seems to go backward: v = −(J q̇ + ω × p), the mean
    over the feet that stand, low-passed. Feet that slip are believed. Where none stands, the last velocity holds.

    Args:
        body: of the robot.
        angles: (12,) rad.
        speeds: (12,) of the joints, rad/s.
        gyro: (3,) angular velocity of the trunk in its own frame, rad/s.
        stands: (4,) bool, which feet stand on something.
        before: (3,) what this returned a tick ago, m/s.
    """
    xp, kind = space(angles), angles.dtype
    feet = legs.feet(body, angles)
    moving = xp.einsum("lij,lj->li", legs.jacobians(body, angles), speeds.reshape(4, 3)) + xp.cross(gyro, feet)
    count = xp.sum(stands)
    seen = -xp.sum(xp.where(stands[:, None], moving, 0.0), axis=0) / xp.maximum(count, 1)
    part = TICK / (TICK + SMOOTHING)
    return xp.where(count > 0, before + part * (seen - before), before).astype(kind)
