"""Signed distances and tangent planes of points to boxes, upright cylinders and the ground."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics.kinematics import Vector
from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import Terrain


class Box(NamedTuple):
    """A box for contact: center (3,), half extents (3,), m, and turn (2,), cosine and sine of its yaw."""

    center: jax.Array
    half: jax.Array
    turn: jax.Array


class Cylinder(NamedTuple):
    """An upright cylinder for contact: center (3,), radius and half height, m."""

    center: jax.Array
    radius: jax.Array
    half: jax.Array


class Planes(NamedTuple):
    """Tangent planes, one per slot.

    Attributes:
        distance: signed distance of a sphere's surface, or of a point, to the plane, m; negative in contact.
        normal: x, y, z, each of the same shape, unit, out of the obstacle.
    """

    distance: jax.Array
    normal: Vector


def _sub(point: Vector, center: jax.Array) -> Vector:
    return (point[0] - center[0], point[1] - center[1], point[2] - center[2])


def _into_box(point: Vector, box: Box) -> tuple[Vector, Vector]:
    """Points in the box's frame, and how far they are beyond its faces along each axis."""
    x, y, z = _sub(point, box.center)
    cos, sin = box.turn[0], box.turn[1]
    local = (cos * x + sin * y, cos * y - sin * x, z)
    return local, tuple(jp.abs(local[i]) - box.half[i] for i in range(3))  # type: ignore[return-value]


def box_distance(point: Vector, box: Box) -> jax.Array:
    """Signed distance of points (x, y, z of any one shape) to a box's surface, negative inside, m."""
    over = _into_box(point, box)[1]
    x, y, z = (jp.maximum(o, 0.0) for o in over)
    inside = jp.minimum(jp.maximum(jp.maximum(over[0], over[1]), over[2]), 0.0)
    return jp.sqrt(x * x + y * y + z * z) + inside


def box_plane(point: Vector, box: Box) -> Planes:
    """Tangent plane of a box at its surface's nearest point to each of some points.

    Outside the box that is the nearest point of face, edge or corner; inside, the nearest face.
    """
    local, over = _into_box(point, box)
    deepest = jp.maximum(jp.maximum(over[0], over[1]), over[2])
    inside = deepest <= 0.0
    # Inside, only the face that is nearest: x before y before z where they tie.
    on_x = over[0] >= deepest
    on_y = (over[1] >= deepest) & ~on_x
    out = [
        jp.where(inside, on.astype(o.dtype), jp.maximum(o, 0.0))
        for o, on in zip(over, (on_x, on_y, ~(on_x | on_y)), strict=True)
    ]
    length = jp.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    x, y, z = (jp.where(side < 0.0, -o, o) / length for side, o in zip(local, out, strict=True))
    cos, sin = box.turn[0], box.turn[1]
    return Planes(jp.where(inside, deepest, length), (cos * x - sin * y, sin * x + cos * y, z))


def _around(point: Vector, cylinder: Cylinder) -> tuple[Vector, jax.Array, jax.Array, jax.Array]:
    """Points relative to a cylinder's centre, their distance to its axis, and to its side and caps, negative inside."""
    local = _sub(point, cylinder.center)
    axial = jp.sqrt(local[0] * local[0] + local[1] * local[1])
    return local, axial, axial - cylinder.radius, jp.abs(local[2]) - cylinder.half


def cylinder_distance(point: Vector, cylinder: Cylinder) -> jax.Array:
    """Signed distance of points to an upright cylinder's surface, negative inside, m."""
    _, _, side, cap = _around(point, cylinder)
    out_side, out_cap = jp.maximum(side, 0.0), jp.maximum(cap, 0.0)
    return jp.sqrt(out_side * out_side + out_cap * out_cap) + jp.minimum(jp.maximum(side, cap), 0.0)


def cylinder_plane(point: Vector, cylinder: Cylinder) -> Planes:
    """Tangent plane of an upright cylinder nearest to each of some points, as :func:`box_plane`."""
    local, axial, side, cap = _around(point, cylinder)
    deepest = jp.maximum(side, cap)
    inside = deepest <= 0.0
    out_side = jp.where(inside, (side >= cap).astype(side.dtype), jp.maximum(side, 0.0))
    out_cap = jp.where(inside, (side < cap).astype(side.dtype), jp.maximum(cap, 0.0))
    length = jp.sqrt(out_side * out_side + out_cap * out_cap)
    # On the axis any direction will do; x is taken.
    centred = axial == 0.0
    radial = out_side / (length * jp.where(centred, 1.0, axial))
    normal = (radial * jp.where(centred, 1.0, local[0]), radial * local[1], jp.sign(local[2]) * out_cap / length)
    return Planes(jp.where(inside, deepest, length), normal)


def ground_plane(terrain: Terrain | None, point: Vector) -> Planes:
    """Tangent plane of the ground beneath each of some points: of z = 0, or of the triangle of the heightfield."""
    if terrain is None:
        zero = jp.zeros_like(point[2])
        return Planes(point[2], (zero, zero, zero + 1.0))
    if point[0].ndim == 2:  # many environments, each over its own heightfield
        of_each = jax.vmap(ground, in_axes=(0, -1, -1), out_axes=-1)
        height, slope_x, slope_y = of_each(terrain, point[0], point[1])
    else:
        height, slope_x, slope_y = ground(terrain, point[0], point[1])
    up = jax.lax.rsqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return Planes((point[2] - height) * up, (-slope_x * up, -slope_y * up, up))
