"""The same depth image from C MuJoCo's rays: the tests' oracle, and the camera of a robot that runs without JAX.

Only NumPy and MuJoCo are imported. Heightfields may be cast at as meshes, which is faster:
loco_mjx/deploy/terrain_rays.py.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

if TYPE_CHECKING:
    from loco_mjx.robots.robot import Vector3

VISIBLE_GROUPS = (2,)  # geom groups of a written scene that are seen; the robot's own are others


class Optics(Protocol):
    """What a camera is: DepthConfig, or the camera of an exported policy. Angles in degrees, lengths in metres."""

    @property
    def height(self) -> int: ...  # noqa: D102

    @property
    def width(self) -> int: ...  # noqa: D102

    @property
    def vertical_fov(self) -> float: ...  # noqa: D102

    @property
    def horizontal_fov(self) -> float: ...  # noqa: D102

    @property
    def near(self) -> float: ...  # noqa: D102

    @property
    def far(self) -> float: ...  # noqa: D102


class Terrain(Protocol):
    """More to be seen than the model has."""

    def nearest(
        self, origin: np.ndarray, unit: np.ndarray, groups: np.ndarray, hit: np.ndarray, far: np.ndarray
    ) -> None:
        """Puts what is nearer than the hits so far into them."""
        ...


@functools.cache
def directions(height: int, width: int, vertical_fov: float, horizontal_fov: float) -> np.ndarray:
    """(height * width, 3) rays in the camera frame (forward, left, up), forward component 1, row by row."""
    wide = math.tan(math.radians(horizontal_fov) / 2)
    high = math.tan(math.radians(vertical_fov) / 2)
    left = wide * (1 - (2 * np.arange(width) + 1) / width)
    up = high * (1 - (2 * np.arange(height) + 1) / height)
    rays = np.ones((height, width, 3))
    rays[..., 1], rays[..., 2] = left[None, :], up[:, None]
    return rays.reshape(-1, 3)


def nearest(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    origin: np.ndarray,
    unit: np.ndarray,
    groups: np.ndarray,
    cutoff: float = np.inf,
) -> tuple[np.ndarray, np.ndarray]:
    """What rays hit first.

    Args:
        model: the scene.
        data: its state after ``mj_kinematics``; each thread needs its own, for MuJoCo's scratch memory.
        origin: (3,) m, of all rays.
        unit: (N · 3,) their directions.
        groups: (mjNGROUP,) uint8, of geoms that are hit.
        cutoff: m, beyond which nothing is.

    Returns:
        hit: (N,) int32, the geom, or −1; distance: (N,) m.
    """
    count = unit.size // 3
    hit, distance = np.full(count, -1, np.int32), np.zeros(count)
    mujoco.mj_multiRay(model, data, origin, unit, groups, True, -1, hit, distance, None, count, cutoff)
    return hit, distance


def cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    mount: Vector3,
    config: Optics,
    groups: tuple[int, ...] = VISIBLE_GROUPS,
    terrain: Terrain | None = None,
) -> np.ndarray:
    """Planar depth of a scene written as MJCF, seen from a robot's base.

    Args:
        model: the compiled scene.
        data: its state after ``mj_kinematics``; each thread needs its own, for MuJoCo's scratch memory.
        qpos: (7 or more,) base position, base quaternion (w, x, y, z), and whatever follows.
        mount: the camera in the base's frame, m.
        config: size, field of view and clips of the image.
        groups: geom groups that are seen.
        terrain: what else is seen.

    Returns:
        (height, width) depth in metres, clipped to [near, far]; misses read ``far``.
    """
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(qpos[3:7], np.float64) / np.linalg.norm(qpos[3:7]))
    rotation = matrix.reshape(3, 3)
    origin = np.asarray(qpos[:3], np.float64) + rotation @ np.asarray(mount)
    rays = directions(config.height, config.width, config.vertical_fov, config.horizontal_fov) @ rotation.T
    length = np.linalg.norm(rays, axis=1)  # of a ray per metre of planar depth
    visible = np.zeros(mujoco.mjNGROUP, np.uint8)
    visible[list(groups)] = 1
    # Nothing farther than `far` is in range; but MuJoCo leaves out an infinite plane whose origin is beyond the cutoff.
    cutoff = config.far * float(length.max()) + float(np.linalg.norm(origin))
    unit = (rays / length[:, None]).ravel()
    hit, distance = nearest(model, data, origin, unit, visible, cutoff)
    if terrain is not None:
        terrain.nearest(origin, unit, visible, hit, distance)
    depth = np.where(hit >= 0, distance / length, config.far)
    return np.clip(depth, config.near, config.far).reshape(config.height, config.width)
