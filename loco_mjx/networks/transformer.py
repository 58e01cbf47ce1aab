"""Transformer encoder: post-norm layers with one attention head, no positional embedding."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jp


class SelfAttention(nn.Module):
    """Single-head scaled dot-product self-attention; queries, keys and values come from one projection."""

    @nn.compact
    def __call__(self, tokens: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(..., n, C) tokens to the attended (..., n, C), and the weights (..., n, n), rows summing to 1."""
        dim = tokens.shape[-1]
        # One C × C block each, so that the initial scale is a C × C matrix's.
        init = nn.initializers.variance_scaling(1.0, "fan_in", "uniform")
        query, key, value = jp.split(nn.Dense(3 * dim, kernel_init=init, name="qkv")(tokens), 3, axis=-1)
        scores = jp.einsum("...qc,...kc->...qk", query, key) * dim**-0.5  # (..., n, n)
        weights = nn.softmax(scores, axis=-1)
        attended = jp.einsum("...qk,...kc->...qc", weights, value)  # (..., n, C)
        return nn.Dense(dim, kernel_init=init, name="output")(attended), weights


class EncoderLayer(nn.Module):
    """Attention and a two-layer MLP, each added to its input and then normalised.

    Attributes:
        mlp_dim: hidden width of the MLP.
    """

    mlp_dim: int

    @nn.compact
    def __call__(self, tokens: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(..., n, C) tokens to (..., n, C), and the attention weights (..., n, n)."""
        init = nn.initializers.variance_scaling(1.0, "fan_in", "uniform")
        attended, weights = SelfAttention(name="attention")(tokens)
        tokens = nn.LayerNorm(epsilon=1e-5, name="norm_attention")(tokens + attended)
        hidden = nn.relu(nn.Dense(self.mlp_dim, kernel_init=init, name="mlp_in")(tokens))  # (..., n, mlp_dim)
        mixed = nn.Dense(tokens.shape[-1], kernel_init=init, name="mlp_out")(hidden)
        return nn.LayerNorm(epsilon=1e-5, name="norm_mlp")(tokens + mixed), weights


class Transformer(nn.Module):
    """A stack of encoder layers.

    Attributes:
        layers: how many; with 0 the tokens pass unchanged.
        mlp_dim: hidden width of each layer's MLP.
    """

    layers: int
    mlp_dim: int

    @nn.compact
    def __call__(self, tokens: jax.Array) -> tuple[jax.Array, jax.Array | None]:
        """(..., n, C) tokens to (..., n, C), and the last layer's attention (..., n, n) or None without layers."""
        weights = None
        for i in range(self.layers):
            tokens, weights = EncoderLayer(self.mlp_dim, name=f"layer_{i}")(tokens)
        return tokens, weights
