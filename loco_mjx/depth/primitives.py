"""Rays against boxes, spheres and upright cylinders: which can be in the image, and at what depth.

Everything is a structure of arrays: one component of all pixels' rays is one flat vector, a primitive's parameters are
scalars. Divisions by a ray's component are multiplications by a reciprocal that never is infinite, and minima are
written as selections: `jp.minimum` keeps NaNs, which costs three instructions on a CPU where a selection costs one.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import DepthConfig
from loco_mjx.scene.types import Boxes, Cylinders, Spheres

TINY = 1e-9  # stands in for a ray component of zero


@struct.dataclass
class Rays:
    """All pixels' rays from one point, in the world; the ray parameter is planar depth.

    Attributes:
        x, y, z: (pixels,) components, per metre of planar depth.
        inverse_x, inverse_y, inverse_z: (pixels,) their finite reciprocals.
        square, level_square: (pixels,) squared length, and of the part along the ground.
        inverse_square, inverse_level_square: (pixels,) their finite reciprocals.
    """

    x: jax.Array
    y: jax.Array
    z: jax.Array
    inverse_x: jax.Array
    inverse_y: jax.Array
    inverse_z: jax.Array
    square: jax.Array
    level_square: jax.Array
    inverse_square: jax.Array
    inverse_level_square: jax.Array


def smaller(a: jax.Array, b: jax.Array | float) -> jax.Array:
    """Elementwise minimum that does not care for NaN."""
    return jp.where(a < b, a, b)


def larger(a: jax.Array, b: jax.Array | float) -> jax.Array:
    """Elementwise maximum that does not care for NaN."""
    return jp.where(a > b, a, b)


def reciprocal(x: jax.Array) -> jax.Array:
    """1 / x, finite everywhere."""
    return 1.0 / jp.where(jp.abs(x) < TINY, TINY, x)


def make_rays(rotation: jax.Array, left: jax.Array, up: jax.Array) -> Rays:
    """The rays of :func:`camera.rays`, turned into the world.

    Args:
        rotation: (3, 3) camera rotation, columns forward, left, up.
        left: (pixels,) component along the camera's left.
        up: (pixels,) component along the camera's up.
    """
    x, y, z = (rotation[i, 0] + rotation[i, 1] * left + rotation[i, 2] * up for i in range(3))
    level = x * x + y * y
    square = level + z * z
    inverse_x, inverse_y, inverse_z = reciprocal(x), reciprocal(y), reciprocal(z)
    return Rays(x, y, z, inverse_x, inverse_y, inverse_z, square, level, 1.0 / square, reciprocal(level))


def frustum(rotation: jax.Array, config: DepthConfig) -> tuple[jax.Array, jax.Array]:
    """The six planes that bound what a camera sees, as inward normals in the world.

    Returns:
        normals (6, 3), not of unit length, and offsets (6,): a point p relative to the camera is inside where
        normals · p + offsets > 0.
    """
    wide = math.tan(math.radians(config.horizontal_fov) / 2)
    high = math.tan(math.radians(config.vertical_fov) / 2)
    forward, left, up = rotation[:, 0], rotation[:, 1], rotation[:, 2]
    sides = [wide * forward - left, wide * forward + left, high * forward - up, high * forward + up]
    normals = jp.stack([forward, -forward, *sides])
    return normals, jp.array([0.0, config.far, 0.0, 0.0, 0.0, 0.0], jp.float32)


def _reaches(planes: tuple[jax.Array, jax.Array], center: jax.Array, support: jax.Array) -> jax.Array:
    """(N,) whether shapes reach inside every plane; ``support`` (N, 6) is their extent along each normal."""
    normals, offsets = planes
    distance = sum(center[:, i : i + 1] * normals[:, i] for i in range(3)) + offsets
    return jp.all(distance + support > 0.0, axis=1)


def boxes_in_view(planes: tuple[jax.Array, jax.Array], boxes: Boxes, center: jax.Array) -> jax.Array:
    """(N,) False for boxes that no ray can hit; ``center`` (N, 3) is relative to the camera."""
    x, y, z = planes[0].T
    cos, sin = jp.cos(boxes.yaw)[:, None], jp.sin(boxes.yaw)[:, None]
    half_x, half_y, half_z = (boxes.half[:, i : i + 1] for i in range(3))
    support = half_x * jp.abs(cos * x + sin * y) + half_y * jp.abs(cos * y - sin * x) + half_z * jp.abs(z)
    return _reaches(planes, center, support)


def spheres_in_view(planes: tuple[jax.Array, jax.Array], spheres: Spheres, center: jax.Array) -> jax.Array:
    """(S,) False for spheres that are collected or that no ray can hit; ``center`` is relative to the camera."""
    length = jp.sqrt(jp.sum(planes[0] * planes[0], axis=1))
    return _reaches(planes, center, spheres.radius[:, None] * length) & ~spheres.collected


def cylinders_in_view(planes: tuple[jax.Array, jax.Array], cylinders: Cylinders, center: jax.Array) -> jax.Array:
    """(C,) False for cylinders that no ray can hit; ``center`` is relative to the camera."""
    x, y, z = planes[0].T
    support = cylinders.radius[:, None] * jp.sqrt(x * x + y * y) + cylinders.half_height[:, None] * jp.abs(z)
    return _reaches(planes, center, support)


def _closer(best: jax.Array, near: jax.Array, far: jax.Array) -> jax.Array:
    """The nearer of ``best`` and a shape that the rays are inside of from ``near`` to ``far``.

    A camera inside a shape reads 0, which the clip makes the shortest depth there is.
    """
    near = larger(near, 0.0)
    return jp.where((near <= far) & (near < best), near, best)


def plane(rays: Rays, height: jax.Array, far: float) -> jax.Array:
    """Depth of the plane z = 0 from a camera ``height`` above it; ``far`` where it is not seen."""
    depth = -height * rays.inverse_z
    return jp.where((rays.z < 0.0) & (depth > 0.0) & (depth < far), depth, far)


def upright_box(best: jax.Array, rays: Rays, box: jax.Array) -> jax.Array:
    """Depth of the nearer of ``best`` (pixels,) and an unturned box (6,): centre relative to the camera, half."""
    x, y, z = box[0] * rays.inverse_x, box[1] * rays.inverse_y, box[2] * rays.inverse_z
    half_x, half_y = box[3] * jp.abs(rays.inverse_x), box[4] * jp.abs(rays.inverse_y)
    half_z = box[5] * jp.abs(rays.inverse_z)
    near = larger(larger(x - half_x, y - half_y), z - half_z)
    return _closer(best, near, smaller(smaller(x + half_x, y + half_y), z + half_z))


def turned_box(best: jax.Array, rays: Rays, box: jax.Array) -> jax.Array:
    """As :func:`upright_box` for a box (8,) turned about z: centre in its own axes, half, cosine, sine of its yaw."""
    inverse_x = reciprocal(box[6] * rays.x + box[7] * rays.y)
    inverse_y = reciprocal(box[6] * rays.y - box[7] * rays.x)
    return upright_box(best, dataclasses.replace(rays, inverse_x=inverse_x, inverse_y=inverse_y), box)


def sphere(best: jax.Array, rays: Rays, ball: jax.Array) -> jax.Array:
    """Depth of the nearer of ``best`` (pixels,) and a sphere (4,): centre relative to the camera, radius."""
    along = ball[0] * rays.x + ball[1] * rays.y + ball[2] * rays.z
    outside = ball[0] * ball[0] + ball[1] * ball[1] + ball[2] * ball[2] - ball[3] * jp.abs(ball[3])
    discriminant = along * along - rays.square * outside
    near = (along - jp.sqrt(larger(discriminant, 0.0))) * rays.inverse_square
    # A camera outside sees what is ahead; one inside sees nothing else.
    seen = (discriminant > 0.0) & ((near > 0.0) | (outside < 0.0)) & (near < best)
    return jp.where(seen, larger(near, 0.0), best)


def cylinder(best: jax.Array, rays: Rays, trunk: jax.Array) -> jax.Array:
    """Depth of the nearer of ``best`` and an upright cylinder (5,): centre from the camera, radius, half height."""
    along = trunk[0] * rays.x + trunk[1] * rays.y
    outside = trunk[0] * trunk[0] + trunk[1] * trunk[1] - trunk[3] * jp.abs(trunk[3])
    discriminant = along * along - rays.level_square * outside
    side = (along - jp.sqrt(larger(discriminant, 0.0))) * rays.inverse_level_square
    z, half_z = trunk[2] * rays.inverse_z, trunk[4] * jp.abs(rays.inverse_z)
    cap, far = z - half_z, z + half_z
    on_cap = (rays.level_square * cap - 2.0 * along) * cap + outside <= 0.0
    near = larger(side, cap)
    inside = (outside < 0.0) & (jp.abs(trunk[2]) < trunk[4])
    seen = (discriminant > 0.0) & (near <= far) & ((side >= cap) | on_cap) & ((near > 0.0) | inside) & (near < best)
    return jp.where(seen, larger(near, 0.0), best)
