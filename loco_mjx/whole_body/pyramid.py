"""The friction pyramid of one foot's force: six bounds C f ≤ b, and what an interior-point method needs of them.

|x| ≤ μ z, |y| ≤ μ z, least ≤ z ≤ most. Arrays are (horizon, legs, components, N), robots last.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp

ROWS = 6


def rows(friction: float, forces: jax.Array) -> jax.Array:
    """C f: (H, 4, 6, N) of (H, 4, 3, N)."""
    x, y, z = (forces[:, :, i] for i in range(3))
    reach = friction * z
    return jp.stack([x - reach, -x - reach, y - reach, -y - reach, -z, z], axis=2)


def transposed(friction: float, prices: jax.Array) -> jax.Array:
    """Cᵀ p: (H, 4, 3, N) of (H, 4, 6, N)."""
    a, b, c, d, least, most = (prices[:, :, i] for i in range(ROWS))
    return jp.stack([a - b, c - d, most - least - friction * (a + b + c + d)], axis=2)


def bounds(least: jax.Array, most: jax.Array) -> jax.Array:
    """The bounds b (6, N), of vertical forces' limits (N,)."""
    zero = jp.zeros_like(least)
    return jp.stack([zero, zero, zero, zero, -least, most])


class Block(NamedTuple):
    """K = I + Cᵀ diag(w) C of every foot, for weights w, eliminated: x and y follow z.

    Nothing here cancels. Weights grow beyond all bounds as a force comes to lie on the pyramid, and how fast it gets
    there has to be known relative to what is left of the way.

    Attributes:
        weights: (H, 4, 6, N) w.
        xx: (H, 4, N) of x alone, inverse.
        yy: (H, 4, N) of y alone, inverse.
        z: (H, 4, N) of z with x and y eliminated, inverse.
        across: x and y per z if nothing but z is pushed, each (H, 4, N).
    """

    weights: jax.Array
    xx: jax.Array
    yy: jax.Array
    z: jax.Array
    across: tuple[jax.Array, jax.Array]


def block(friction: float, weights: jax.Array) -> Block:
    """K for weights (H, 4, 6, N)."""
    a, b, c, d, least, most = (weights[:, :, i] for i in range(ROWS))
    xx, yy = 1 / (1 + a + b), 1 / (1 + c + d)
    side = (a + b + 4 * a * b) * xx + (c + d + 4 * c * d) * yy
    z = 1 / (1 + least + most + friction * friction * side)
    return Block(weights, xx, yy, z, (friction * (a - b) * xx, friction * (c - d) * yy))


def inverse(block: Block) -> jax.Array:
    """K⁻¹: (H, 4, 3, 3, N)."""
    _, xx, yy, z, (p, q) = block
    pz, qz, pq = p * z, q * z, p * q * z
    lines = ((xx + p * pz, pq, pz), (pq, yy + q * qz, qz), (pz, qz, z))
    return jp.stack([jp.stack(line, axis=2) for line in lines], axis=2)


def solve(friction: float, block: Block, pull: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Forces K⁻¹ r (H, 4, 3, N) of r (H, 4, 3, N), and their rows C K⁻¹ r (H, 4, 6, N), not made of the forces."""
    (a, b, c, d), (x, y, z) = (block.weights[:, :, i] for i in range(4)), (pull[:, :, i] for i in range(3))
    (p, q), up = block.across, block.z * (z + block.across[0] * x + block.across[1] * y)
    reach = friction * up
    rows = (
        block.xx * (x - (1 + 2 * b) * reach),
        block.xx * (-x - (1 + 2 * a) * reach),
        block.yy * (y - (1 + 2 * d) * reach),
        block.yy * (-y - (1 + 2 * c) * reach),
        -up,
        up,
    )
    return jp.stack([block.xx * x + p * up, block.yy * y + q * up, up], axis=2), jp.stack(rows, axis=2)
