"""The depth camera: rigid on the trunk, looking along trunk x.

Camera frame: forward (the optical axis), left, up. A ray's forward component is 1, so the ray parameter at a hit *is*
the planar depth, and an image pixel is a point of the plane one metre ahead.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import rotations
from loco_mjx.config import DepthConfig
from loco_mjx.robots.robot import Vector3


def pose(qpos: jax.Array, mount: Vector3) -> tuple[jax.Array, jax.Array]:
    """Where the camera is, from the free base's pose alone.

    Args:
        qpos: (7 or more,) base position, base quaternion (w, x, y, z), and whatever follows.
        mount: the camera in the base's frame, m.

    Returns:
        origin (3,) in the world, m, and rotation (3, 3) whose columns are forward, left, up in the world.
    """
    rotation = rotations.matrix(qpos[3:7], jp)
    origin = qpos[:3] + mount[0] * rotation[:, 0]
    for axis in (1, 2):
        origin = origin + mount[axis] * rotation[:, axis] if mount[axis] else origin
    return origin, rotation


def rays(config: DepthConfig) -> tuple[np.ndarray, np.ndarray]:
    """The pixels' rays in the camera frame: forward 1, and the two components returned.

    Pixel centres are spaced evenly in the image plane (tan-linear), row 0 on top, column 0 on the left.

    Returns:
        left (height * width,) and up (height * width,), float32, row by row.
    """
    half_width = math.tan(math.radians(config.horizontal_fov) / 2)
    half_height = math.tan(math.radians(config.vertical_fov) / 2)
    left = half_width * (1 - (2 * np.arange(config.width) + 1) / config.width)
    up = half_height * (1 - (2 * np.arange(config.height) + 1) / config.height)
    up, left = np.meshgrid(up, left, indexing="ij")
    return left.ravel().astype(np.float32), up.ravel().astype(np.float32)
