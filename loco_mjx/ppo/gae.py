"""Generalised advantage estimation (Schulman et al. 2016) with terminations, truncations and reset rows."""

from __future__ import annotations

import jax
import jax.numpy as jp


def advantages(
    rewards: jax.Array,
    values: jax.Array,
    terminated: jax.Array,
    done: jax.Array,
    reset: jax.Array,
    discount: float,
    gae_lambda: float,
) -> jax.Array:
    """λ-advantages of a window of T transitions.

    The observation after a `done` row is the episode's real last one, so a truncated row bootstraps from `values[t+1]`
    like a running one; a terminated row does not. Both cut the λ-sum. The transition after a `done` row only resets the
    environment: its advantage is 0, and nothing of it reaches another row.

    Args:
        rewards: (T, ...) r_t.
        values: (T+1, ...) V(obs_t), including the observation after the window.
        terminated: (T, ...) 1 where the episode ended by itself.
        done: (T, ...) 1 where it ended, by itself or at a time limit.
        reset: (T, ...) 1 where the transition spans a reset.
        discount: γ.
        gae_lambda: λ.

    Returns:
        (T, ...) advantages; the value targets are ``advantages + values[:-1]``.
    """
    deltas = rewards + discount * (1.0 - terminated) * values[1:] - values[:-1]
    decay = discount * gae_lambda * (1.0 - done)

    def backward(later: jax.Array, row: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, keep, skip = row
        advantage = jp.where(skip > 0, 0.0, delta + keep * later)
        return advantage, advantage

    _, result = jax.lax.scan(backward, jp.zeros_like(values[0]), (deltas, decay, reset), reverse=True)
    return result
