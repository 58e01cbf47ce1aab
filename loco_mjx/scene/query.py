"""Questions that rewards and metrics ask of a scene."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jp

from loco_mjx.scene.types import OBSTACLE, Scene

COLLECT_DISTANCE = 0.2  # m, between base and sphere in the horizontal plane


def collect(scene: Scene, base_xy: jax.Array) -> tuple[Scene, jax.Array]:
    """Collects the spheres at the robot.

    Args:
        scene: one environment's scene.
        base_xy: (2,) position of the base, m.

    Returns:
        The scene with the spheres within COLLECT_DISTANCE marked collected, and how many of them are new (int32).
    """
    spheres = scene.spheres
    offset = spheres.center[:, :2] - base_xy
    near = jp.sum(offset * offset, axis=-1) < COLLECT_DISTANCE**2
    new = near & spheres.reward & ~spheres.collected
    spheres = replace(spheres, collected=spheres.collected | new)
    return replace(scene, spheres=spheres), jp.sum(new, dtype=jp.int32)


def first_obstacle_x(scene: Scene) -> jax.Array:
    """Smallest x of an obstacle's centre (OBSTACLE boxes and cylinders), m; infinite where there is none."""
    boxes = jp.where(scene.boxes.kind == OBSTACLE, scene.boxes.center[:, 0], jp.inf)
    return jp.minimum(jp.min(boxes, initial=jp.inf), jp.min(scene.cylinders.center[:, 0], initial=jp.inf))
