"""The height of the ground: exact interpolation of a heightfield, and the steps that stand on it."""

from __future__ import annotations

import jax
import jax.numpy as jp

from loco_mjx.scene.types import STEP, Boxes, Scene, Terrain


def ground(terrain: Terrain | None, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Height and slope of the heightfield under points, on the same triangles as C MuJoCo's hfield.

    MuJoCo splits each cell along the diagonal from vertex (i, j) to vertex (i + 1, j + 1), in its rays as in its
    contacts (tests/oracle/test_scene_hfield.py). Outside the grid the border's heights go on, level across it.

    Args:
        terrain: the heightfield, or None for the plane z = 0.
        x: points' x, m, any shape.
        y: points' y, m, the same shape.

    Returns:
        Height in m, dz/dx and dz/dy, each of the points' shape.
    """
    if terrain is None:
        zero = jp.zeros_like(x)
        return zero, zero, zero
    nx, ny = terrain.heights.shape
    u, i, inside_x = _locate(x, terrain.origin[0], terrain.cell, nx)
    v, j, inside_y = _locate(y, terrain.origin[1], terrain.cell, ny)
    flat = terrain.heights.reshape(-1)
    lower = u >= v  # the triangle that holds vertex (i + 1, j); the other one holds (i, j + 1)
    base = i * ny + j
    start = flat[base]
    end = flat[base + ny + 1]
    third = flat[base + jp.where(lower, ny, 1)]
    rise_x = jp.where(lower, third - start, end - third)
    rise_y = jp.where(lower, end - third, third - start)
    height = start + rise_x * u + rise_y * v
    slope_x = jp.where(inside_x, rise_x / terrain.cell, 0.0)
    slope_y = jp.where(inside_y, rise_y / terrain.cell, 0.0)
    return height, slope_x, slope_y


def _locate(x: jax.Array, origin: float, cell: float, count: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Position within its cell (0…1), the cell's index, and whether it is inside the grid, along one axis."""
    position = (x - origin) / cell
    clamped = jp.clip(position, 0.0, count - 1.0)
    # The second clip holds for NaN too, whose conversion to an integer is undefined.
    index = jp.clip(jp.floor(clamped).astype(jp.int32), 0, count - 2)
    return clamped - index, index, (position >= 0.0) & (position <= count - 1.0)


def ground_height(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    """Height of what one can stand on under a point: the ground, or the highest STEP box above it.

    Args:
        scene: one environment's scene.
        x: the point's x, m, scalar.
        y: the point's y, m, scalar.

    Returns:
        Height in m, scalar.
    """
    height, _, _ = ground(scene.terrain, x, y)
    if scene.boxes.count == 0:
        return height
    tops = scene.boxes.center[:, 2] + scene.boxes.half[:, 2]
    beneath = (scene.boxes.kind == STEP) & _covers(scene.boxes, x, y)
    return jp.maximum(height, jp.max(jp.where(beneath, tops, -jp.inf)))


def _covers(boxes: Boxes, x: jax.Array, y: jax.Array) -> jax.Array:
    """(N,) whether each box's footprint holds the point."""
    dx, dy = x - boxes.center[:, 0], y - boxes.center[:, 1]
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    return (jp.abs(along) <= boxes.half[:, 0]) & (jp.abs(across) <= boxes.half[:, 1])
