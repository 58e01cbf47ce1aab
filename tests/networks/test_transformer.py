"""The transformer against the formulas, written out in numpy."""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.networks.transformer import EncoderLayer, SelfAttention, Transformer


def _layer_norm(x, params):
    centred = x - x.mean(-1, keepdims=True)
    return centred / np.sqrt((centred**2).mean(-1, keepdims=True) + 1e-5) * params["scale"] + params["bias"]


def test_encoder_layer_equals_numpy(key):
    tokens = jax.random.normal(key, (5, 8))
    layer = EncoderLayer(mlp_dim=12)
    # Not as initialised, where biases and norms are trivial.
    draw = np.random.default_rng(0)
    shapes = jax.eval_shape(layer.init, key, tokens)
    params = jax.tree.map(lambda x: 0.3 * draw.standard_normal(x.shape, np.float32), shapes)
    out, weights = jax.jit(layer.apply)(params, tokens)

    p = jax.tree.map(np.asarray, params["params"])
    x = np.asarray(tokens)
    query, k, value = np.split(x @ p["attention"]["qkv"]["kernel"] + p["attention"]["qkv"]["bias"], 3, -1)
    scores = query @ k.T / np.sqrt(8)
    expected_weights = np.exp(scores) / np.exp(scores).sum(-1, keepdims=True)
    attended = expected_weights @ value @ p["attention"]["output"]["kernel"] + p["attention"]["output"]["bias"]
    x = _layer_norm(x + attended, p["norm_attention"])
    hidden = np.maximum(x @ p["mlp_in"]["kernel"] + p["mlp_in"]["bias"], 0)
    x = _layer_norm(x + hidden @ p["mlp_out"]["kernel"] + p["mlp_out"]["bias"], p["norm_mlp"])
    np.testing.assert_allclose(weights, expected_weights, atol=1e-5)
    np.testing.assert_allclose(out, x, atol=1e-5)


def test_attention_rows_sum_to_one(key):
    tokens = 5.0 * jax.random.normal(key, (3, 17, 8))
    (_, weights), _ = jax.jit(SelfAttention().init_with_output)(key, tokens)
    assert weights.shape == (3, 17, 17)
    np.testing.assert_allclose(weights.sum(-1), 1.0, atol=1e-5)
    assert float(weights.min()) >= 0.0


def test_no_layers_pass_the_tokens_unchanged(key):
    tokens = jax.random.normal(key, (4, 8))
    (out, weights), variables = Transformer(layers=0, mlp_dim=12).init_with_output(key, tokens)
    np.testing.assert_array_equal(out, tokens)
    assert weights is None
    assert not variables


def test_tokens_carry_no_position(key):
    tokens = jax.random.normal(key, (6, 8))
    module = Transformer(layers=2, mlp_dim=12)
    order = np.array([3, 1, 5, 0, 2, 4])
    params = jax.jit(module.init)(key, tokens)
    (out, shuffled), _ = jax.jit(module.apply)(params, jp.stack([tokens, tokens[order]]))
    np.testing.assert_allclose(shuffled, out[order], atol=1e-5)
