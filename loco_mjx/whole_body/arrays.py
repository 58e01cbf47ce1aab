"""What NumPy and JAX have in common: this room computes with either, whichever its inputs are made of.

So a simulation compiled by JAX and a robot's computer without JAX run the same lines.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx import rotations

Array = Any  # numpy.ndarray or jax.Array, and all of a function's arguments the same of the two


def space(array: Array) -> Any:
    """The module that computes with an array: `numpy`, or `jax.numpy` for whatever is not NumPy's."""
    if isinstance(array, np.ndarray | np.generic | float | int):
        return np
    import jax.numpy as jp

    return jp


def rotation(quat: Array) -> Array:
    """(3, 3) rotation matrix of a quaternion (4,) (w, x, y, z), which need not have unit length."""
    return rotations.matrix(quat, space(quat))


def level(turned: Array) -> tuple[Array, Array]:
    """Roll and pitch of a trunk, and its rotation without its yaw.

    Args:
        turned: (3, 3) rotation from the trunk's frame into the world's.

    Returns:
        (2,) roll and pitch, rad, and (3, 3) rotation from the trunk's frame into the level one, whose z is the world's
        and whose x is the heading.
    """
    xp = space(turned)
    roll, pitch = xp.arctan2(turned[2, 1], turned[2, 2]), -xp.arcsin(xp.clip(turned[2, 0], -1.0, 1.0))
    (sr, cr), (sp, cp) = (xp.sin(roll), xp.cos(roll)), (xp.sin(pitch), xp.cos(pitch))
    zero = xp.zeros_like(sr)
    rows = [
        xp.stack([cp, sp * sr, sp * cr]),
        xp.stack([zero, cr, -sr]),
        xp.stack([-sp, cp * sr, cp * cr]),
    ]
    return xp.stack([roll, pitch]), xp.stack(rows)


def skew(vectors: Array) -> Array:
    """(n, 3, 3) matrices of the cross products with vectors (n, 3)."""
    xp = space(vectors)
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    zero = xp.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
