"""Where the robot's joints and collision spheres are, in closed form from qpos.

Coordinates are kept apart (x, y, z as separate arrays over legs or spheres): on every backend that is what vectorises
best. Every function takes arrays of one environment, or of many with the environments on the last axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import rotations
from loco_mjx.robots import Robot

Vector = tuple[jax.Array, jax.Array, jax.Array]  # x, y, z, arrays of one shape


class Pose(NamedTuple):
    """The robot in the world frame; each vector is x, y, z.

    Attributes:
        origin: of the trunk, each (), m.
        forward: the trunk's x axis, and the axis of the hip joints, each ().
        left: its y axis, each ().
        up: its z axis, each ().
        hip: anchors of the hip joints, each (4,), m.
        shoulder: anchors of the thigh joints, each (4,), m.
        knee: anchors of the calf joints, each (4,), m.
        foot: centres of the feet, each (4,), m.
        side: axis of the thigh and calf joints, each (4,).
    """

    origin: Vector
    forward: Vector
    left: Vector
    up: Vector
    hip: Vector
    shoulder: Vector
    knee: Vector
    foot: Vector
    side: Vector


def column(values: Sequence[float] | np.ndarray, like: jax.Array) -> np.ndarray:
    """Constants (n,) shaped to broadcast against an array (n, ...)."""
    return np.asarray(values, np.float32).reshape(-1, *[1] * (like.ndim - 1))


def pose(robot: Robot, qpos: jax.Array) -> Pose:
    """Anchors and axes of all joints.

    Args:
        robot: whose.
        qpos: (19,) base position, base quaternion (w, x, y, z), joint angles.
    """
    hip, thigh, calf = (qpos[7 + part :: 3] for part in range(3))  # (4,) each: FR, FL, RR, RL
    ahead, aside, above = (column([place[i] for place in robot.hips], hip) for i in range(3))
    sin, cos = jp.sin(hip), jp.cos(hip)
    zero = jp.zeros_like(hip)
    origin: Vector = (qpos[0], qpos[1], qpos[2])
    forward, left, up = rotations.axes(qpos[3:7], jp)

    def turn(x: Any, y: Any, z: Any) -> Vector:
        return tuple(forward[i] * x + left[i] * y + up[i] * z for i in range(3))  # type: ignore[return-value]

    def add(a: Vector, b: Vector) -> Vector:
        return tuple(p + q for p, q in zip(a, b, strict=True))  # type: ignore[return-value]

    def link(bend: jax.Array, x: float, z: float) -> Vector:
        """A link's vector from joint to joint, (x, 0, z) in its own frame, bent about the side axis."""
        along, down = np.float32(z) * jp.sin(bend), np.float32(z) * jp.cos(bend)
        if x:
            along, down = along + np.float32(x) * jp.cos(bend), down - np.float32(x) * jp.sin(bend)
        return turn(along, -sin * down, cos * down)

    anchor = add(origin, turn(ahead + zero, aside + zero, above + zero if above.any() else zero))
    offset = column(robot.thigh_offset, hip)
    shoulder = add(anchor, turn(zero, offset * cos, offset * sin))
    knee = add(shoulder, link(thigh, 0.0, -robot.thigh_length))
    foot = add(knee, link(thigh + calf, *robot.foot))
    return Pose(origin, forward, left, up, anchor, shoulder, knee, foot, turn(zero, cos, sin))


def trunk_centers(robot: Robot, pose: Pose) -> Vector:
    """Centres of the trunk's spheres, x, y, z, each (T,), m."""
    trunk = np.asarray([sphere.center for sphere in robot.trunk_spheres], np.float32)
    ahead, aside, above = (column(trunk[:, i], pose.hip[0]) for i in range(3))
    return tuple(  # type: ignore[return-value]
        pose.origin[i] + pose.forward[i] * ahead + pose.left[i] * aside + pose.up[i] * above for i in range(3)
    )


def calf_centers(pose: Pose) -> Vector:
    """Centres of the calves' spheres, halfway between knee and foot, x, y, z, each (4,), m."""
    x, y, z = (0.5 * (knee + foot) for knee, foot in zip(pose.knee, pose.foot, strict=True))
    return x, y, z


def centers(robot: Robot, pose: Pose) -> Vector:
    """Centres of all spheres in the world frame, x, y, z, each (S,), m, in the order of `robot.spheres`."""
    groups = (pose.foot, pose.shoulder, pose.knee, calf_centers(pose), trunk_centers(robot, pose))
    return tuple(jp.concatenate([group[i] for group in groups]) for i in range(3))  # type: ignore[return-value]


def sphere_centers(robot: Robot, qpos: jax.Array) -> Vector:
    """Centres of all collision spheres.

    Args:
        robot: whose.
        qpos: (19,) base position, base quaternion (w, x, y, z), joint angles.

    Returns:
        x, y, z, each (S,), m, world frame, in the order of `robot.spheres`.
    """
    return centers(robot, pose(robot, qpos))
