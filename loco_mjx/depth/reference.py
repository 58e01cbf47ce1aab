"""The same depth image from C MuJoCo's ray casting: the tests' oracle, and a depth source that knows nothing of ours.

Only NumPy and MuJoCo are imported: a rehearsal of deployment runs this without JAX.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from loco_mjx.config import DepthConfig
    from loco_mjx.robots.robot import Vector3

VISIBLE_GROUPS = (2,)  # geom groups of a written scene that are seen; the robot's own are others


def directions(config: DepthConfig) -> np.ndarray:
    """(height * width, 3) rays in the camera frame (forward, left, up), forward component 1, row by row."""
    wide = math.tan(math.radians(config.horizontal_fov) / 2)
    high = math.tan(math.radians(config.vertical_fov) / 2)
    left = wide * (1 - (2 * np.arange(config.width) + 1) / config.width)
    up = high * (1 - (2 * np.arange(config.height) + 1) / config.height)
    rays = np.ones((config.height, config.width, 3))
    rays[..., 1], rays[..., 2] = left[None, :], up[:, None]
    return rays.reshape(-1, 3)


def cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    mount: Vector3,
    config: DepthConfig,
    groups: tuple[int, ...] = VISIBLE_GROUPS,
) -> np.ndarray:
    """Planar depth of a scene written as MJCF, seen from a robot's base.

    Args:
        model: the compiled scene.
        data: its state after ``mj_kinematics``; each thread needs its own, for MuJoCo's scratch memory.
        qpos: (7 or more,) base position, base quaternion (w, x, y, z), and whatever follows.
        mount: the camera in the base's frame, m.
        config: size, field of view and clips of the image.
        groups: geom groups that are seen.

    Returns:
        (height, width) depth in metres, clipped to [near, far]; misses read ``far``.
    """
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(qpos[3:7], np.float64) / np.linalg.norm(qpos[3:7]))
    rotation = matrix.reshape(3, 3)
    origin = np.asarray(qpos[:3], np.float64) + rotation @ np.asarray(mount)
    rays = directions(config) @ rotation.T
    length = np.linalg.norm(rays, axis=1)  # of a ray per metre of planar depth
    visible = np.zeros(mujoco.mjNGROUP, np.uint8)
    visible[list(groups)] = 1
    hit, distance = np.full(len(rays), -1, np.int32), np.zeros(len(rays))
    # Nothing farther than `far` is in range; but MuJoCo leaves out an infinite plane whose origin is beyond the cutoff.
    cutoff = config.far * float(length.max()) + float(np.linalg.norm(origin))
    unit = (rays / length[:, None]).ravel()
    mujoco.mj_multiRay(model, data, origin, unit, visible, True, -1, hit, distance, None, len(rays), cutoff)
    depth = np.where(hit >= 0, distance / length, config.far)
    return np.clip(depth, config.near, config.far).reshape(config.height, config.width)
