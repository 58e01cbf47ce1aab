"""The encoding's table, worked out by hand, and the blind pixels' distribution."""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.depth.encoding import blind_pixels, decode, encode

CONFIG = DepthConfig()


@pytest.mark.parametrize(
    ("depth", "code"),
    [
        (0.3, -1.735964),  # sqrt(ln 1.3) = 0.512215
        (1.0, -0.982225),  # sqrt(ln 2) = 0.832555
        (3.770733, 0.0),  # ln(1 + d) = 1.25²
        (10.0, 0.702385),  # sqrt(ln 11) = 1.548514
    ],
)
def test_encode_table(depth: float, code: float) -> None:
    np.testing.assert_allclose(encode(jp.float32(depth)), code, atol=3e-6)


def test_decode_inverts_encode() -> None:
    depth = jp.linspace(CONFIG.near, CONFIG.far, 200).reshape(4, 50)
    np.testing.assert_allclose(decode(encode(depth)), depth, rtol=1e-5)


def test_blind_pixels_count_and_value() -> None:
    image = jp.ones((64, 64))
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    blind = np.asarray(jax.vmap(lambda key: blind_pixels(key, image, CONFIG))(keys))
    assert set(np.unique(blind)) == {1.0, 10.0}
    count = (blind == 10.0).sum(axis=(1, 2))
    # n = U{3..30} has mean 16.5 and standard deviation 8.08: 0.18 for the mean of 2000; drawn twice: about 0.04 fewer.
    assert 1 <= count.min() <= 3 and 29 <= count.max() <= 30
    assert abs(count.mean() - 16.46) < 0.8
    # 33,000 draws over 4,096 pixels: each pixel is missed with probability e^-8.
    assert (blind == 10.0).any(axis=0).mean() > 0.99


def test_blind_pixels_leaves_the_rest() -> None:
    image = jax.random.uniform(jax.random.PRNGKey(1), (64, 64), minval=0.3, maxval=9.0)
    blind = blind_pixels(jax.random.PRNGKey(2), image, DepthConfig(blind_min=5, blind_max=5))
    assert 4 <= int(jp.sum(blind != image)) <= 5
    assert bool(jp.all((blind == image) | (blind == 10.0)))


def test_no_blind_pixels() -> None:
    image = jp.ones((64, 64))
    none = DepthConfig(blind_min=0, blind_max=0)
    np.testing.assert_array_equal(blind_pixels(jax.random.PRNGKey(3), image, none), image)
