"""Quaternions (w, x, y, z), as MuJoCo has them: for JAX and for NumPy, for one or with many on the last axis."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

Axis = tuple[Any, Any, Any]  # x, y, z in the world


def unit(quat: Any, xp: ModuleType = np) -> Any:
    """A quaternion (4, ...) of length 1; `xp` is numpy or jax.numpy, here and below."""
    return quat / xp.sqrt(xp.sum(quat * quat, axis=0))


def axes(quat: Any, xp: ModuleType = np) -> tuple[Axis, Axis, Axis]:
    """The body's axes forward (x), left (y) and up (z) in the world, of a quaternion of any non-zero length."""
    w, x, y, z = unit(quat, xp)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )


def matrix(quat: Any, xp: ModuleType = np) -> Any:
    """(3, 3, ...) from the body's frame into the world's, of a quaternion (4, ...): its columns are the axes."""
    return xp.stack([xp.stack(axis) for axis in axes(quat, xp)], axis=1)


def upright(quat: Any) -> Any:
    """The z of the body's up axis, of a unit quaternion: 1 upright, 0 on its side."""
    _, x, y, _ = quat
    return 1 - 2 * (x * x + y * y)


def roll_pitch(quat: Any, xp: ModuleType = np) -> Any:
    """(2,) roll and pitch, rad, of a unit quaternion (4,)."""
    w, x, y, z = quat
    roll = xp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = xp.arcsin(xp.clip(2 * (w * y - z * x), -1.0, 1.0))
    return xp.stack([roll, pitch])


def yaw(quat: Any, xp: ModuleType = np) -> Any:
    """Heading, rad, of a unit quaternion (4,)."""
    w, x, y, z = quat
    return xp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def turned(quat: np.ndarray, angle: float) -> np.ndarray:
    """(4,) a unit quaternion after a turn of the world about z, rad."""
    (c, _, _, s), (w, x, y, z) = from_yaw(angle), quat
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])


def from_yaw(angle: float) -> np.ndarray:
    """(4,) quaternion of a turn about z, rad."""
    return np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])
