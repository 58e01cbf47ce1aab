"""The convolutions written as matrix products are convolutions."""

from __future__ import annotations

import contextlib

import flax.linen as nn
import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.networks.encoders import DepthEncoder, VisualTokens, matmul_convolution
from tests.refusals import refusal

SHAPES = [(64, 8, 4, 4, 8), (15, 4, 2, 8, 6), (6, 3, 1, 6, 5), (4, 2, 2, 5, 7)]


@pytest.mark.parametrize(("side", "size", "stride", "channels", "features"), SHAPES)
def test_matmul_convolution_equals_flax_conv(key, side, size, stride, channels, features):
    image_key, kernel_key, weight_key = jax.random.split(key, 3)
    image = jax.random.normal(image_key, (3, side, side, channels))
    kernel = jax.random.normal(kernel_key, (size, size, channels, features))
    conv = nn.Conv(features, (size, size), (stride, stride), "VALID", use_bias=False)

    def reference(image, kernel):
        return conv.apply({"params": {"kernel": kernel}}, image)

    def ours(image, kernel):
        return matmul_convolution(image, kernel, stride)

    def result_and_gradients(f):
        out, pull = jax.vjp(f, image, kernel)
        return out, *pull(jax.random.normal(weight_key, out.shape))

    got, expected = jax.jit(lambda: (result_and_gradients(ours), result_and_gradients(reference)))()
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-3, atol=1e-3), got, expected)


@pytest.mark.parametrize(("height", "width"), [(64, 48), (48, 64), (35, 35)])
def test_images_that_the_trunk_cannot_take_are_refused(height, width):
    with refusal(f"env.observation.depth {height} {width} square 36"):
        jax.eval_shape(DepthEncoder().init, jax.random.PRNGKey(0), jp.zeros((height, width, 4)))


@pytest.mark.parametrize(("side", "tokens", "fits"), [(4, 4, True), (5, 4, False), (1, 1, True), (1, 2, False)])
def test_a_map_that_does_not_divide_into_the_tokens_is_refused(side, tokens, fits):
    with contextlib.nullcontext() if fits else refusal(f"{side} network.tokens_per_side {tokens} 64"):
        jax.eval_shape(VisualTokens(8, tokens).init, jax.random.PRNGKey(0), jp.zeros((side, side, 64)))


def test_depth_encoder_is_the_atari_trunk(key):
    class Trunk(nn.Module):
        @nn.compact
        def __call__(self, x):
            for i, (features, kernel, stride) in enumerate([(32, 8, 4), (64, 4, 2), (64, 3, 1)]):
                x = nn.relu(nn.Conv(features, (kernel, kernel), stride, "VALID", name=f"conv_{i}")(x))
            return x

    depth = jax.random.normal(key, (2, 64, 64, 4))
    params = jax.jit(Trunk().init)(key, depth)
    out, expected = jax.jit(lambda: (DepthEncoder().apply(params, depth), Trunk().apply(params, depth)))()
    assert out.shape == (2, 4, 4, 64)
    np.testing.assert_allclose(out, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("side", [1, 2, 4])
def test_visual_tokens_go_row_by_row_and_see_their_own_part_only(key, side):
    features = jax.random.normal(key, (4, 4, 8))
    module = VisualTokens(token_dim=5, tokens_per_side=side)
    params = jax.jit(module.init)(key, features)
    both = jax.jit(module.apply)(params, jp.stack([features, features.at[0, 3].add(1.0)]))  # the top right corner
    tokens, changed = both
    assert tokens.shape == (side * side, 5)
    moved = np.flatnonzero(np.abs(changed - tokens).max(-1) > 1e-6)
    assert moved.tolist() == [side - 1]
