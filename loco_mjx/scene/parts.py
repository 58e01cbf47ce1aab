"""Parts that layouts are made of: boxes, walls, empty sets, and points scattered at a distance from one another."""

from __future__ import annotations

import math

import jax
import jax.numpy as jp

from loco_mjx.scene.types import OBSTACLE, WALL, Boxes, Cylinders, Scene, Spheres, Terrain

WALL_X = (-12.0, 84.0)  # m, where walls begin and end
CANDIDATES = 8  # darts thrown at once


def make_boxes(
    center: jax.Array,
    half: jax.Array,
    kind: int = OBSTACLE,
    yaw: jax.Array | None = None,
    velocity: jax.Array | None = None,
) -> Boxes:
    """Boxes of one kind, standing still and unturned unless said.

    Args:
        center: (N, 3) centres, m.
        half: (N, 3) or (3,) half extents, m.
        kind: OBSTACLE, WALL or STEP.
        yaw: (N,) rotation about z, rad.
        velocity: (N, 2) velocity, m/s.
    """
    count = center.shape[0]
    return Boxes(
        center=center.astype(jp.float32),
        half=jp.broadcast_to(half, (count, 3)).astype(jp.float32),
        yaw=jp.zeros((count,), jp.float32) if yaw is None else yaw,
        velocity=jp.zeros((count, 2), jp.float32) if velocity is None else velocity,
        kind=jp.full((count,), kind, jp.int32),
    )


def no_boxes() -> Boxes:
    """Boxes with N = 0."""
    return make_boxes(jp.zeros((0, 3), jp.float32), jp.zeros((0, 3), jp.float32))


def no_spheres() -> Spheres:
    """Spheres with S = 0."""
    return Spheres(
        center=jp.zeros((0, 3), jp.float32),
        radius=jp.zeros((0,), jp.float32),
        collected=jp.zeros((0,), bool),
        reward=jp.zeros((0,), bool),
    )


def no_cylinders() -> Cylinders:
    """Cylinders with C = 0."""
    return Cylinders(
        center=jp.zeros((0, 3), jp.float32), radius=jp.zeros((0,), jp.float32), half_height=jp.zeros((0,), jp.float32)
    )


def make_scene(
    boxes: Boxes | None = None,
    spheres: Spheres | None = None,
    cylinders: Cylinders | None = None,
    ground_field: Terrain | None = None,
    goal: jax.Array | None = None,
) -> Scene:
    """A scene of the given parts; what is left out is empty, the ground is the plane z = 0."""
    return Scene(
        boxes=no_boxes() if boxes is None else boxes,
        spheres=no_spheres() if spheres is None else spheres,
        cylinders=no_cylinders() if cylinders is None else cylinders,
        terrain=ground_field,
        goal=jp.zeros((3,), jp.float32) if goal is None else goal,
    )


def join(first: Boxes, second: Boxes) -> Boxes:
    """Both sets of boxes as one."""
    return jax.tree.map(lambda a, b: jp.concatenate([a, b]), first, second)


def walls(y: float, half_thickness: float, height: float) -> Boxes:
    """Two walls along x, centred at ±y, from WALL_X[0] to WALL_X[1], standing on z = 0."""
    middle, half_length = 0.5 * (WALL_X[0] + WALL_X[1]), 0.5 * (WALL_X[1] - WALL_X[0])
    center = jp.array([[middle, -y, 0.5 * height], [middle, y, 0.5 * height]])
    return make_boxes(center, jp.array([half_length, half_thickness, 0.5 * height]), WALL)


def scatter(
    key: jax.Array, count: int, low: tuple[float, float], high: tuple[float, float], distance: float
) -> jax.Array:
    """Points uniform over a rectangle with at least ``distance`` between any two (dart throwing).

    A dart that lands too close to an earlier point is thrown again. ``count`` − 1 discs of radius ``distance`` have
    less area than the rectangle, so there is always room for the next point: the loop ends with probability 1.

    Args:
        key: random key.
        count: how many points.
        low: smallest (x, y), m.
        high: largest (x, y), m.
        distance: smallest distance, m.

    Returns:
        (count, 2) points, m.

    Raises:
        ValueError: if the rectangle is too small to be sure of room for every point.
    """
    if (count - 1) * math.pi * distance**2 >= (high[0] - low[0]) * (high[1] - low[1]):
        raise ValueError(f"{count} points {distance} m apart may not fit in {low} to {high}")

    def throw(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        key, placed, points = carry
        key, dart_key = jax.random.split(key)
        # dart = +U(low, high)
        darts = jax.random.uniform(dart_key, (CANDIDATES, 2), minval=jp.array(low), maxval=jp.array(high))
        dx = darts[:, None, 0] - points[None, :, 0]
        dy = darts[:, None, 1] - points[None, :, 1]
        fits = jp.all(dx * dx + dy * dy >= distance**2, axis=1)
        here = (jp.arange(count) == placed) & jp.any(fits)
        return key, placed + jp.any(fits), jp.where(here[:, None], darts[jp.argmax(fits)], points)

    far_away = jp.full((count, 2), 1e6, jp.float32)
    return jax.lax.while_loop(lambda carry: carry[1] < count, throw, (key, jp.int32(0), far_away))[2]
