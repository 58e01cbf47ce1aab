"""Where swinging feet go: Raibert's footholds, reached on a parabola."""

from __future__ import annotations

import numpy as np

from loco_mjx.whole_body.arrays import Array, space
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import Body


def footholds(config: WholeBodyConfig, body: Body, attitude: Array, rates: Array, command: Array) -> Array:
    """(4, 3) where feet are to land, in the trunk's frame, m.

    A foot lands half a stance's way ahead of its hip, and farther ahead if the robot is faster than it should be:
    p = hip + v T / 2 − k (v_desired − v), where v is the hip's velocity.

    Args:
        config: of the controller.
        body: of the robot.
        attitude: (3, 3) from the trunk's frame into the level one.
        rates: (6,) angular velocity and velocity of the trunk in the level frame, rad/s and m/s.
        command: (2,) speed ahead, m/s, and yaw rate, rad/s.
    """
    xp = space(rates)
    rest = np.array(body.hips)
    rest[:, 1] += body.offsets
    x, y = rest[:, 0], rest[:, 1]
    moving = xp.stack([rates[3] - rates[2] * y, rates[4] + rates[2] * x], axis=-1)
    desired = xp.stack([command[0] - command[1] * y, command[1] * x], axis=-1)
    ahead = 0.5 * config.gait.stance * moving - config.swing.feedback * (desired - moving)
    level = (attitude @ rest.T).T
    below = xp.full((4, 1), config.swing.landing - config.height)
    return (attitude.T @ xp.concatenate([level[:, :2] + ahead, below], axis=-1).T).T


def way(config: WholeBodyConfig, start: Array, end: Array, part: Array) -> Array:
    """(4, 3) where swinging feet are to be.

    Along x and y in a straight line; along z a parabola through start, end and, halfway, `clearance` above the higher
    of the two. Most of the way is made in the first half of the time: the foot hurries up and comes down gently.

    Args:
        config: of the controller.
        start: (4, 3) where the feet were when they were lifted, m.
        end: (4, 3) where they are to land, m.
        part: (4,) of the swing that has passed.
    """
    xp = space(part)
    warped = xp.where(part <= 0.5, 0.8 * xp.sin(np.pi * part), 0.8 + (part - 0.5) * 0.4)[:, None]
    straight = start + (end - start) * warped
    low, high = start[:, 2:], end[:, 2:]
    middle = xp.maximum(low, high) + config.swing.clearance
    # z(0) = low, z(1/2) = middle, z(1) = high
    bend = 2 * (low + high - 2 * middle)
    z = low + (high - low - bend) * warped + bend * warped**2
    return xp.concatenate([straight[:, :2], z], axis=-1)
