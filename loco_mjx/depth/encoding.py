"""What the networks see of a depth image: a logarithmic encoding, and the sensor's blind pixels."""

from __future__ import annotations

import jax
import jax.numpy as jp

from loco_mjx.config import DepthConfig

OFFSET = 1.25
SCALE = 0.425


def encode(depth: jax.Array) -> jax.Array:
    """Depth in metres to the networks' input, (sqrt(ln(d + 1)) - 1.25) / 0.425; any shape."""
    return (jp.sqrt(jp.log1p(depth)) - OFFSET) / SCALE


def decode(code: jax.Array) -> jax.Array:
    """The inverse of :func:`encode`; any shape."""
    return jp.expm1(jp.square(code * SCALE + OFFSET))


def blind_pixels(key: jax.Array, depth: jax.Array, config: DepthConfig) -> jax.Array:
    """Sets a random number of random pixels to the far clip, as a real depth sensor's dropouts.

    Args:
        key: PRNG key.
        depth: (height, width) depth in metres.
        config: ``blind_min``, ``blind_max`` and ``far`` are read.

    Returns:
        (height, width) depth in metres; pixels are drawn with replacement, so fewer than drawn may differ.
    """
    key_count, key_pixel = jax.random.split(key)
    count = jax.random.randint(key_count, (), config.blind_min, config.blind_max + 1)  # n = U{blind_min..blind_max}
    pixel = jax.random.randint(key_pixel, (config.blind_max,), 0, depth.size)  # pixel = U{0..size - 1}
    pixel = jp.where(jp.arange(config.blind_max) < count, pixel, depth.size)  # out of bounds: dropped
    return depth.ravel().at[pixel].set(config.far, mode="drop").reshape(depth.shape)
