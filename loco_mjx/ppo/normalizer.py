"""Running mean and variance of the `state` observation (Chan et al.'s parallel update)."""

from __future__ import annotations

import jax
import jax.numpy as jp
from flax import struct

CLIP = 10.0  # standard deviations
_EPSILON = 1e-8  # added to the variance


@struct.dataclass
class Normalizer:
    """Statistics of a vector.

    Attributes:
        count: () how many vectors were added.
        mean: (n,) their mean.
        squares: (n,) their summed squared deviations from the mean.
    """

    count: jax.Array
    mean: jax.Array
    squares: jax.Array


def create(size: int) -> Normalizer:
    """Statistics of no vectors: normalising only clips."""
    return Normalizer(jp.zeros((), jp.float32), jp.zeros(size, jp.float32), jp.zeros(size, jp.float32))


def of(mean: jax.Array, std: jax.Array) -> Normalizer:
    """Statistics with a given mean and :func:`std`, (n,) each, and a count of one vector."""
    return Normalizer(jp.ones((), jp.float32), jp.asarray(mean), jp.asarray(std) ** 2 - _EPSILON)


def _psum(x: jax.Array, axis_name: str | None) -> jax.Array:
    return x if axis_name is None else jax.lax.psum(x, axis_name)


def update(normalizer: Normalizer, x: jax.Array, weight: jax.Array, axis_name: str | None = None) -> Normalizer:
    """Adds vectors to the statistics.

    Args:
        normalizer: statistics so far.
        x: (..., n) vectors.
        weight: (...) 1, or 0 for those to leave out (whatever they hold).
        axis_name: mesh axis over which the vectors are sharded, if any.
    """
    axes = tuple(range(x.ndim - 1))
    x = jp.where(weight[..., None] > 0, x, 0.0)
    count = _psum(jp.sum(weight), axis_name)
    mean = _psum(jp.sum(x, axes), axis_name) / jp.maximum(count, 1.0)
    squares = _psum(jp.sum(weight[..., None] * (x - mean) ** 2, axes), axis_name)
    total = jp.maximum(normalizer.count + count, 1.0)
    shift = mean - normalizer.mean
    # n = n₁ + n₂; μ = μ₁ + Δ n₂ / n; M = M₁ + M₂ + Δ² n₁ n₂ / n, with Δ = μ₂ − μ₁
    return Normalizer(
        count=normalizer.count + count,
        mean=normalizer.mean + shift * count / total,
        squares=normalizer.squares + squares + shift**2 * normalizer.count * count / total,
    )


def std(normalizer: Normalizer) -> jax.Array:
    """(n,) standard deviations; 1 without any vectors."""
    variance = normalizer.squares / jp.maximum(normalizer.count, 1.0)
    return jp.sqrt(jp.where(normalizer.count > 0, variance, 1.0) + _EPSILON)


def normalize(normalizer: Normalizer, x: jax.Array) -> jax.Array:
    """(..., n) vectors in standard deviations from the mean, clipped to ±10."""
    return jp.clip((x - normalizer.mean) / std(normalizer), -CLIP, CLIP)
