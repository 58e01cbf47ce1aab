"""Heightfields drawn on the device: sums of plane waves, cells with one rock each, and a few large shapes.

Everything is written as outer products over the grid's two axes, so that hundreds of terrains take seconds.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jp

from loco_mjx.scene.types import Terrain

FLAT_RADIUS = 1.6  # m around the origin, level: the start is drawn within ±1 m
GOAL_DISTANCE = 11.0  # m from the origin to a summit, horizontally
GOAL_BEARING = 0.3  # rad, largest angle between +x and the summit
MOUNTAIN_ORIGIN, MOUNTAIN_CELL, MOUNTAIN_SHAPE = (-4.0, -8.0), 0.1, (200, 160)
UNEVEN_ORIGIN, UNEVEN_CELL, UNEVEN_SHAPE = (-12.18, -3.54), 0.12, (804, 60)
FOREST_ORIGIN, FOREST_CELL, FOREST_SHAPE = (-12.0, -6.5), 0.12, (805, 110)


def _axes(origin: tuple[float, float], cell: float, shape: tuple[int, int]) -> tuple[jax.Array, jax.Array]:
    """The vertices' x as (nx, 1) and y as (1, ny), m."""
    return (origin[0] + cell * jp.arange(shape[0]))[:, None], (origin[1] + cell * jp.arange(shape[1]))[None, :]


def smoothstep(x: jax.Array) -> jax.Array:
    """0 below 0, 1 above 1, smooth between."""
    t = jp.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def waves(key: jax.Array, x: jax.Array, y: jax.Array, longest: float, shortest: float, count: int = 16) -> jax.Array:
    """A random smooth field of zero mean and unit variance: a sum of plane waves.

    Args:
        key: random key.
        x: (nx, 1) m.
        y: (1, ny) m.
        longest: longest wavelength, m.
        shortest: shortest wavelength, m.
        count: number of waves.

    Returns:
        (nx, ny) field.
    """
    direction_key, length_key, phase_key = jax.random.split(key, 3)
    angle = jax.random.uniform(direction_key, (count,), maxval=2.0 * math.pi)  # angle = +U(0, 2π)
    phase = jax.random.uniform(phase_key, (count,), maxval=2.0 * math.pi)  # phase = +U(0, 2π)
    # log wavelength = +U(log shortest, log longest)
    log_length = jax.random.uniform(length_key, (count,), minval=math.log(shortest), maxval=math.log(longest))
    number = 2.0 * math.pi / jp.exp(log_length)
    along_x = x * (number * jp.cos(angle)) + phase  # (nx, count)
    along_y = y.T * (number * jp.sin(angle))  # (ny, count)
    # cos(a + b) = cos a cos b − sin a sin b: two matrix products instead of nx · ny · count cosines
    left = jp.concatenate([jp.cos(along_x), -jp.sin(along_x)], axis=1)
    right = jp.concatenate([jp.cos(along_y), jp.sin(along_y)], axis=1)
    return math.sqrt(2.0 / count) * jp.matmul(left, right.T, precision=jax.lax.Precision.HIGHEST)


def stones(key: jax.Array, shape: tuple[int, int], cell: float, share: float, height: tuple[float, float]) -> jax.Array:
    """Flat-topped stones, at most one in each 5 × 5 block of vertices, of radius 1 to 2 cells.

    Args:
        key: random key.
        shape: vertices of the grid, multiples of 5.
        cell: spacing of the grid, m.
        share: share of the blocks that hold a stone.
        height: lowest and highest stone, m.

    Returns:
        Heights of the grid's shape, m; zero between the stones.
    """
    blocks = (shape[0] // 5, shape[1] // 5)
    present_key, height_key, radius_key, x_key, y_key = jax.random.split(key, 5)
    present = jax.random.bernoulli(present_key, share, blocks)
    top = present * jax.random.uniform(height_key, blocks, minval=height[0], maxval=height[1])  # top = +U(height) m
    radius = jax.random.uniform(radius_key, blocks, minval=1.0, maxval=2.0)  # radius = +U(1, 2) cells
    middle_x = jax.random.uniform(x_key, blocks, minval=1.5, maxval=2.5)  # middle = +U(1.5, 2.5) cells
    middle_y = jax.random.uniform(y_key, blocks, minval=1.5, maxval=2.5)
    local = jp.arange(5.0)
    dx = local[None, :, None, None] - middle_x[:, None, :, None]  # (bx, 5, by, 1)
    dy = local[None, None, None, :] - middle_y[:, None, :, None]  # (bx, 1, by, 5)
    inside = jp.clip(radius[:, None, :, None] + 0.5 - jp.sqrt(dx * dx + dy * dy), 0.0, 1.0)
    return (inside * top[:, None, :, None]).reshape(shape)


def _bumps(
    x: jax.Array, y: jax.Array, middle_x: jax.Array, middle_y: jax.Array, radius: jax.Array, height: jax.Array
) -> jax.Array:
    """The highest of K round bumps at each vertex, (nx, ny); a few only: each is evaluated on the whole grid."""

    def add(field: jax.Array, bump: tuple[jax.Array, ...]) -> tuple[jax.Array, None]:
        bump_x, bump_y, bump_radius, bump_height = bump
        distance = jp.sqrt((x - bump_x) ** 2 + (y - bump_y) ** 2)
        return jp.maximum(field, bump_height * smoothstep(1.5 * (1.0 - distance / bump_radius))), None

    start = jp.zeros((x.shape[0], y.shape[1]), jp.float32)
    return jax.lax.scan(add, start, (middle_x, middle_y, radius, height))[0]


def _goal_xy(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where the summit is, GOAL_DISTANCE from the origin."""
    bearing = jax.random.uniform(key, minval=-GOAL_BEARING, maxval=GOAL_BEARING)  # bearing = +U(-0.3, 0.3) rad
    return GOAL_DISTANCE * jp.cos(bearing), GOAL_DISTANCE * jp.sin(bearing)


def _away_from_start(x: jax.Array, y: jax.Array, width: float = 1.5) -> jax.Array:
    """(nx, ny) weight: 0 within FLAT_RADIUS of the origin, 1 from ``width`` farther on."""
    return smoothstep((jp.sqrt(x * x + y * y) - FLAT_RADIUS) / width)


def mountain(key: jax.Array) -> tuple[Terrain, jax.Array]:
    """A rugged mountain, about 2.5 m high, with crags in the straight line to its summit.

    The slope grows toward the summit. Ridges bend its contours, stones lie everywhere, and six crags, too steep to
    climb on their flanks, stand between start and summit.

    Returns:
        The terrain, level around the origin, and the summit (3,).
    """
    keys = jax.random.split(key, 8)
    goal_key, height_key, contour_key, ridge_key, rough_key, stone_key, crag_key, crag_size_key = keys
    x, y = _axes(MOUNTAIN_ORIGIN, MOUNTAIN_CELL, MOUNTAIN_SHAPE)
    goal_x, goal_y = _goal_xy(goal_key)
    summit = jax.random.uniform(height_key, minval=2.3, maxval=2.7)  # summit = +U(2.3, 2.7) m
    distance = jp.sqrt((x - goal_x) ** 2 + (y - goal_y) ** 2 + 0.09) - 0.3
    far = smoothstep(distance / 2.5)  # keeps the summit the highest point
    nearness = jp.clip(1.0 - (distance + 0.5 * far * waves(contour_key, x, y, 8.0, 4.0)) / 9.4, 0.0, 1.0)
    slope = summit * nearness * (0.55 + 0.45 * nearness)
    ridges = 0.12 * far * (1.0 - jp.abs(waves(ridge_key, x, y, 6.0, 2.5)))
    roughness = 0.01 * waves(rough_key, x, y, 1.2, 0.4)
    rocks = stones(stone_key, MOUNTAIN_SHAPE, MOUNTAIN_CELL, 0.25, (0.02, 0.08))
    crags = _crags(crag_key, crag_size_key, x, y, goal_x, goal_y)
    heights = (slope + ridges + roughness + rocks + crags) * _away_from_start(x, y)
    top = jp.clip(1.0 - distance / 0.6, 0.0, 1.0)
    # Nothing stands higher than the goal.
    heights = jp.minimum(heights, summit) * (1.0 - top) + summit * top
    terrain = Terrain(heights.astype(jp.float32), MOUNTAIN_ORIGIN, MOUNTAIN_CELL)
    return terrain, jp.stack([goal_x, goal_y, summit]).astype(jp.float32)


def _crags(
    key: jax.Array, size_key: jax.Array, x: jax.Array, y: jax.Array, goal_x: jax.Array, goal_y: jax.Array
) -> jax.Array:
    """Six steep outcrops beside and on the line from the origin to the goal, (nx, ny) m."""
    count = 6
    along_key, across_key = jax.random.split(key)
    radius_key, height_key = jax.random.split(size_key)
    # along = (i + U(0.2, 0.8)) / 6 of the way from 30 % to 85 %; across = +U(-1.5, 1.5) m
    spread = (jp.arange(count) + jax.random.uniform(along_key, (count,), minval=0.2, maxval=0.8)) / count
    along = 0.30 + 0.55 * spread
    across = jax.random.uniform(across_key, (count,), minval=-1.5, maxval=1.5) / GOAL_DISTANCE
    middle_x, middle_y = along * goal_x - across * goal_y, along * goal_y + across * goal_x
    radius = jax.random.uniform(radius_key, (count,), minval=0.5, maxval=0.9)  # radius = +U(0.5, 0.9) m
    height = jax.random.uniform(height_key, (count,), minval=0.25, maxval=0.5)  # height = +U(0.25, 0.5) m
    return _bumps(x, y, middle_x, middle_y, radius, height)


def hill(key: jax.Array) -> tuple[Terrain, jax.Array]:
    """Rolling hills, the highest of them 1.2 to 1.6 m high at the goal.

    Returns:
        The terrain, level around the origin, and the top (3,).
    """
    goal_key, height_key, rolling_key, rough_key = jax.random.split(key, 4)
    x, y = _axes(MOUNTAIN_ORIGIN, MOUNTAIN_CELL, MOUNTAIN_SHAPE)
    goal_x, goal_y = _goal_xy(goal_key)
    summit = jax.random.uniform(height_key, minval=1.2, maxval=1.6)  # summit = +U(1.2, 1.6) m
    distance = jp.sqrt((x - goal_x) ** 2 + (y - goal_y) ** 2)
    top = 1.0 - smoothstep(distance / 6.0)
    rolling = 0.2 * waves(rolling_key, x, y, 6.0, 3.0) * (1.0 - top)
    roughness = 0.008 * waves(rough_key, x, y, 1.5, 0.6) * smoothstep(distance)
    heights = (summit * top + rolling + roughness) * _away_from_start(x, y)
    terrain = Terrain(heights.astype(jp.float32), MOUNTAIN_ORIGIN, MOUNTAIN_CELL)
    return terrain, jp.stack([goal_x, goal_y, summit]).astype(jp.float32)


def uneven(key: jax.Array) -> Terrain:
    """Blocks of 0.24 m (2 × 2 vertices): half of them level, half raised by up to 5 cm; level around the start."""
    blocks = (UNEVEN_SHAPE[0] // 2, UNEVEN_SHAPE[1] // 2)
    # height = max(0, U(-0.05, 0.05)) m
    raised = jp.maximum(0.0, jax.random.uniform(key, blocks, minval=-0.05, maxval=0.05))
    heights = jp.repeat(jp.repeat(raised, 2, axis=0), 2, axis=1)
    x, y = _axes(UNEVEN_ORIGIN, UNEVEN_CELL, UNEVEN_SHAPE)
    at_start = (jp.abs(x) < 1.4) & (jp.abs(y) < 1.4)
    return Terrain(jp.where(at_start, 0.0, heights).astype(jp.float32), UNEVEN_ORIGIN, UNEVEN_CELL)


def forest_floor(key: jax.Array) -> Terrain:
    """Rough ground with long slopes, and potholes up to 10 cm deep; level around the start."""
    slope_key, rolling_key, rough_key, hole_key = jax.random.split(key, 4)
    x, y = _axes(FOREST_ORIGIN, FOREST_CELL, FOREST_SHAPE)
    # slope along x = +U(-0.08, 0.08), along y = +U(-0.04, 0.04)
    slope = jax.random.uniform(slope_key, (2,), minval=-1.0, maxval=1.0) * jp.array([0.08, 0.04])
    rolling = 0.12 * waves(rolling_key, x, y, 9.0, 4.0)
    roughness = 0.012 * waves(rough_key, x, y, 1.5, 0.5)
    holes = stones(hole_key, FOREST_SHAPE, FOREST_CELL, 0.12, (0.03, 0.10))
    heights = (slope[0] * x + slope[1] * y + rolling + roughness - holes) * _away_from_start(x, y)
    return Terrain(heights.astype(jp.float32), FOREST_ORIGIN, FOREST_CELL)
