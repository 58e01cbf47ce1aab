"""A quadruped's legs in closed form: where feet are, Jacobians, and joint angles that put them somewhere.

Everything is in the trunk's frame (x forward, y left, z up), legs FR, FL, RR, RL, joints hip, thigh, calf; m and rad.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from loco_mjx.robots import Robot
from loco_mjx.whole_body.arrays import Array, space
from loco_mjx.whole_body.masses import masses


class Body(NamedTuple):
    """What the controller knows of a robot.

    Attributes:
        hips: (4, 3) anchors of the hip joints, m.
        offsets: (4,) from there to the thigh joint along the leg's y axis, positive to the left, m.
        thigh: length, m.
        calf: length to the foot's centre, m.
        bend: by which the line from knee to foot leans forward of the calf, rad.
        lower: (12,) limits of the joints, rad.
        upper: (12,) limits of the joints, rad.
        torque: (12,) limits of the motors, N·m.
        mass: of the whole robot, kg.
        inertia: (3, 3) of the whole robot about its centre of mass in the default pose, kg m².
        center: (3,) that centre of mass in the trunk's frame, m.
    """

    hips: Array
    offsets: Array
    thigh: float
    calf: float
    bend: float
    lower: Array
    upper: Array
    torque: Array
    mass: float
    inertia: Array
    center: Array


def feet(body: Body, angles: Array) -> Array:
    """(4, 3) centres of the feet, m, at joint angles (12,)."""
    xp = space(angles)
    hip, ahead, down = _plane(body, angles)
    sin, cos = xp.sin(hip), xp.cos(hip)
    across = xp.stack([ahead, body.offsets * cos - down * sin, body.offsets * sin + down * cos], axis=-1)
    return body.hips + across


def _plane(body: Body, angles: Array) -> tuple[Array, Array, Array]:
    """(4,) hip angles, and how far ahead and above (negative) of its thigh joint each foot is in its leg's plane."""
    xp = space(angles)
    hip, thigh, calf = angles[0::3], angles[1::3], angles[2::3] + body.bend
    ahead = -body.thigh * xp.sin(thigh) - body.calf * xp.sin(thigh + calf)
    down = -body.thigh * xp.cos(thigh) - body.calf * xp.cos(thigh + calf)
    return hip, ahead, down


def jacobians(body: Body, angles: Array) -> Array:
    """(4, 3, 3) of the feet: velocity of a foot = Jacobian · its leg's joint velocities."""
    xp = space(angles)
    hip, ahead, down = _plane(body, angles)
    sin, cos = xp.sin(hip), xp.cos(hip)
    bend = angles[1::3] + angles[2::3] + body.bend
    y, z = body.offsets * cos - down * sin, body.offsets * sin + down * cos
    knee_ahead, knee_down = -body.calf * xp.cos(bend), body.calf * xp.sin(bend)
    columns = (
        (xp.zeros_like(y), -z, y),
        (down, ahead * sin, -ahead * cos),
        (knee_ahead, -knee_down * sin, knee_down * cos),
    )
    return xp.stack([xp.stack(column, axis=-1) for column in columns], axis=-1)


def angles_for(body: Body, where: Array) -> Array:
    """(12,) joint angles that put the feet's centres at (4, 3), knees backward; the nearest ones within the limits."""
    xp = space(where)
    x, y, z = (where - body.hips).T
    square = xp.maximum(y * y + z * z - body.offsets**2, 1e-6)
    down = -xp.sqrt(square)
    hip = _wrapped(xp, xp.arctan2(z, y) - xp.arctan2(down, body.offsets))
    bent = (x * x + square - body.thigh**2 - body.calf**2) / (2 * body.thigh * body.calf)
    calf = -xp.arccos(xp.clip(bent, -1.0, 1.0))
    knee = xp.arctan2(body.calf * xp.sin(calf), body.thigh + body.calf * xp.cos(calf))
    thigh = _wrapped(xp, xp.arctan2(-x, -down) - knee)
    return xp.clip(xp.stack([hip, thigh, calf - body.bend], axis=-1).reshape(12), body.lower, body.upper)


def _wrapped(xp: object, angle: Array) -> Array:
    """Angles in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def body_of(robot: Robot) -> Body:
    """What the controller needs to know of a robot.

    Raises:
        UserError: if its MJCF does not give the inertia of each link.
    """
    mass, center, inertia = masses(robot)
    x, z = robot.foot
    return Body(
        hips=np.array(robot.hips),
        offsets=np.array(robot.thigh_offset),
        thigh=robot.thigh_length,
        calf=math.hypot(x, z),
        bend=math.atan2(-x, -z),
        lower=np.array(robot.lower),
        upper=np.array(robot.upper),
        torque=np.array(robot.torque_limit),
        mass=mass,
        inertia=inertia,
        center=center,
    )
