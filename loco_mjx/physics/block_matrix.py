"""Vectors and matrices over a robot's 18 degrees of freedom, and the linear systems they make.

What moves the robot couples its base to each leg, but no leg to another, so its matrices have the shape of an arrow: a
6 × 6 block for the base, a 3 × 3 block for each leg, and a 3 × 6 block between each leg and the base. Eliminating the
legs first takes about 1,000 multiplications, a tenth of a dense factorisation.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics.xla import add_up, total

BASE, JOINTS, LEGS = 6, 3, 4  # degrees of freedom of the base, and of a leg; legs


class DofVector(NamedTuple):
    """A vector over the degrees of freedom: base (6, N), joints (3, 4, N), hip, thigh, calf."""

    base: jax.Array
    joints: jax.Array


class BlockMatrix(NamedTuple):
    """A symmetric matrix.

    Attributes:
        base: (6, 6, N).
        coupling: (3, 6, 4, N), a row for each joint.
        joints: (3, 3, 4, N).
    """

    base: jax.Array
    coupling: jax.Array
    joints: jax.Array


def split(vector: jax.Array) -> DofVector:
    """A vector over the degrees of freedom (18, N) as its parts."""
    return DofVector(vector[:BASE], jp.swapaxes(vector[BASE:].reshape(LEGS, JOINTS, -1), 0, 1))


def join(vector: DofVector) -> jax.Array:
    """The (18, N) array of a vector's parts: the inverse of :func:`split`."""
    joints = jp.swapaxes(vector.joints, 0, 1)
    return jp.concatenate([vector.base, joints.reshape(LEGS * JOINTS, -1)])


def from_dense(matrix: jax.Array) -> BlockMatrix:
    """A symmetric matrix (18, 18, N) as its blocks; what is between two legs is left out, for it is 0."""
    rows = jp.moveaxis(matrix[BASE:].reshape(LEGS, JOINTS, BASE + LEGS * JOINTS, -1), 0, 2)
    own = [rows[:, BASE + JOINTS * leg : BASE + JOINTS * (leg + 1), leg] for leg in range(LEGS)]
    return BlockMatrix(matrix[:BASE, :BASE], rows[:, :BASE], jp.stack(own, axis=2))


def inner(a: DofVector, b: DofVector) -> jax.Array:
    """Dot product (N,)."""
    return total(a.base * b.base) + total(total(a.joints * b.joints))


def multiply(matrix: BlockMatrix, vector: DofVector) -> DofVector:
    """Matrix times vector."""
    onto_base = total(matrix.coupling * vector.joints[:, None])  # (6, 4, N)
    base = add_up(matrix.base[:, c] * vector.base[c] for c in range(BASE))
    joints = add_up(matrix.coupling[:, c] * vector.base[c] for c in range(BASE))
    return DofVector(
        base + add_up(onto_base[:, leg] for leg in range(LEGS)),
        joints + add_up(matrix.joints[:, j] * vector.joints[j] for j in range(JOINTS)),
    )


def gauss_jordan(matrix: jax.Array) -> jax.Array:
    """Solves positive definite systems by elimination, which for such matrices needs no pivoting.

    Args:
        matrix: (n, n + k, ...) the matrices, and k right-hand sides beside them.

    Returns:
        (n, k, ...) the solutions.
    """
    n = matrix.shape[0]
    index = np.arange(n, dtype=np.int32).reshape(-1, *[1] * (matrix.ndim - 1))

    # A loop, because unrolled XLA would fuse the steps and compute every element again for each of its uses.
    def step(k: jax.Array, matrix: jax.Array) -> jax.Array:
        pivot_row = jax.lax.dynamic_index_in_dim(matrix, k, 0, keepdims=True)
        row = pivot_row / jax.lax.dynamic_index_in_dim(pivot_row, k, 1, keepdims=True)
        column = jax.lax.dynamic_index_in_dim(matrix, k, 1, keepdims=True)
        return jp.where(index == k, row, matrix - column * row)

    return jax.lax.fori_loop(0, n, step, matrix)[:, n:]


def solve(matrix: BlockMatrix, vector: DofVector) -> DofVector:
    """Solves matrix · x = vector for a positive definite matrix."""
    right = vector.joints[:, None]
    solved = gauss_jordan(jp.concatenate([matrix.joints, matrix.coupling, right], axis=1))  # (3, 7, 4, N)
    gain = add_up(matrix.coupling[j][:, None] * solved[j][None] for j in range(JOINTS))  # (6, 7, 4, N)
    onto_base = add_up(gain[:, :, leg] for leg in range(LEGS))
    left = jp.concatenate([matrix.base, vector.base[:, None]], axis=1)
    x = gauss_jordan(left - onto_base)[:, 0]
    return DofVector(x, solved[:, BASE] - add_up(solved[:, c] * x[c] for c in range(BASE)))
