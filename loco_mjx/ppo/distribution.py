"""Diagonal Gaussian over actions before the tanh; log-probabilities and entropy are the Gaussian's.

The tanh that bounds the action lies outside, so that its Jacobian, the same for old and new policy, never enters.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jp

_LOG_2PI = math.log(2.0 * math.pi)


def sample(key: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """One draw, shaped like `mean`."""
    # a = mean + std · +N(0, 1)
    return mean + jp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)


def log_prob(action: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """Log density of (..., n) actions, summed over the last axis: (...)."""
    # log p(a) = Σ −½ ((a − μ) / σ)² − log σ − ½ log 2π
    z = (action - mean) * jp.exp(-log_std)
    return jp.sum(-0.5 * z * z - log_std - 0.5 * _LOG_2PI, axis=-1)


def entropy(log_std: jax.Array) -> jax.Array:
    """Entropy in nats, summed over the last axis: (...)."""
    # H = Σ log σ + ½ (1 + log 2π)
    return jp.sum(log_std + 0.5 * (_LOG_2PI + 1.0), axis=-1)
