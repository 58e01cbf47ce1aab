"""Where the robot's joints and collision spheres are, in closed form from qpos.

Coordinates are kept apart (x, y, z as separate arrays over legs or spheres): on every backend that is what vectorises
best. Every function takes arrays of one environment, or of many with the environments on the last axis.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import a1

Vector = tuple[jax.Array, jax.Array, jax.Array]  # x, y, z, arrays of one shape

# Spheres in this order everywhere in this room: feet, hips, knees, calves (each FR, FL, RR, RL), trunk.
LEGS = 4
TRUNK_SPHERES: tuple[str, ...] = ("front", "rear", "front_right", "front_left", "rear_right", "rear_left")
TRUNK_CENTERS: tuple[tuple[float, float, float], ...] = (
    (0.2, 0.0, 0.0),
    (-0.2, 0.0, 0.0),
    (0.07, -0.04, 0.0),
    (0.07, 0.04, 0.0),
    (-0.07, -0.04, 0.0),
    (-0.07, 0.04, 0.0),
)
SPHERES: tuple[str, ...] = (
    *(f"{leg}_{part}_sphere" for part in ("foot", "hip", "knee", "calf") for leg in a1.LEGS),
    *(f"trunk_{name}_sphere" for name in TRUNK_SPHERES),
)
_OF_LEGS = (a1.FOOT_RADIUS, 0.045, 0.025, 0.02)
RADII: tuple[float, ...] = (*np.repeat(_OF_LEGS, LEGS).tolist(), *[0.057] * len(TRUNK_SPHERES))


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


def column(values: tuple[float, ...] | np.ndarray, like: jax.Array) -> np.ndarray:
    """Constants (n,) shaped to broadcast against an array (n, ...)."""
    return np.asarray(values, np.float32).reshape(-1, *[1] * (like.ndim - 1))


def rotation(quat: jax.Array) -> tuple[Vector, Vector, Vector]:
    """Axes (forward, left, up) of a quaternion (4,) (w, x, y, z), which need not have unit length."""
    w, x, y, z = quat / jp.sqrt(jp.sum(quat * quat, axis=0))
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def pose(qpos: jax.Array) -> Pose:
    """Anchors and axes of all joints.

    Args:
        qpos: (19,) base position, base quaternion (w, x, y, z), joint angles.
    """
    hip, thigh, calf = (qpos[7 + part :: 3] for part in range(3))  # (4,) each: FR, FL, RR, RL
    ahead, aside = column((1.0, 1.0, -1.0, -1.0), hip), column((-1.0, 1.0, -1.0, 1.0), hip)
    sin, cos = jp.sin(hip), jp.cos(hip)
    zero = jp.zeros_like(hip)
    origin: Vector = (qpos[0], qpos[1], qpos[2])
    forward, left, up = rotation(qpos[3:7])

    def turn(x: Any, y: Any, z: Any) -> Vector:
        return tuple(forward[i] * x + left[i] * y + up[i] * z for i in range(3))  # type: ignore[return-value]

    def add(a: Vector, b: Vector) -> Vector:
        return tuple(p + q for p, q in zip(a, b, strict=True))  # type: ignore[return-value]

    def link(bend: jax.Array) -> Vector:
        """A link's vector from joint to joint, bent about the side axis from hanging straight down."""
        down = np.float32(-a1.LINK_LENGTH) * jp.cos(bend)
        return turn(np.float32(-a1.LINK_LENGTH) * jp.sin(bend), -sin * down, cos * down)

    anchor = add(origin, turn(ahead * np.float32(a1.HIP_X) + zero, aside * np.float32(a1.HIP_Y) + zero, zero))
    offset = aside * np.float32(a1.THIGH_OFFSET)
    shoulder = add(anchor, turn(zero, offset * cos, offset * sin))
    knee = add(shoulder, link(thigh))
    foot = add(knee, link(thigh + calf))
    return Pose(origin, forward, left, up, anchor, shoulder, knee, foot, turn(zero, cos, sin))


def trunk_centers(robot: Pose) -> Vector:
    """Centres of the trunk's spheres, x, y, z, each (6,), m."""
    trunk = np.asarray(TRUNK_CENTERS, np.float32)
    ahead, aside, above = (column(trunk[:, i], robot.hip[0]) for i in range(3))
    return tuple(  # type: ignore[return-value]
        robot.origin[i] + robot.forward[i] * ahead + robot.left[i] * aside + robot.up[i] * above for i in range(3)
    )


def calf_centers(robot: Pose) -> Vector:
    """Centres of the calves' spheres, halfway between knee and foot, x, y, z, each (4,), m."""
    x, y, z = (0.5 * (knee + foot) for knee, foot in zip(robot.knee, robot.foot, strict=True))
    return x, y, z


def centers(robot: Pose) -> Vector:
    """Centres of all spheres in the world frame, x, y, z, each (22,), m, in the order of SPHERES."""
    groups = (robot.foot, robot.shoulder, robot.knee, calf_centers(robot), trunk_centers(robot))
    return tuple(jp.concatenate([group[i] for group in groups]) for i in range(3))  # type: ignore[return-value]


def sphere_centers(qpos: jax.Array) -> Vector:
    """Centres of all collision spheres.

    Args:
        qpos: (19,) base position, base quaternion (w, x, y, z), joint angles.

    Returns:
        x, y, z, each (22,), m, world frame, in the order of SPHERES.
    """
    return centers(pose(qpos))
