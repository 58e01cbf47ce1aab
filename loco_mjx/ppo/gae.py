"""Generalised advantage estimation (Schulman et al. 2016) with terminations, truncations and resets."""

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
    """λ-advantages of a rollout of T transitions.

    The observation after a `done` transition is the episode's real last one. So a truncated transition bootstraps from
    `values[t+1]` like any other, and a terminated one does not; both end the sum over later TD errors. The transition
    after a `done` one only resets the environment: its advantage is 0, and it changes no other.

    Args:
        rewards: (T, ...) r_t.
        values: (T+1, ...) V(obs_t), including that of the observation after the last step.
        terminated: (T, ...) 1 where the episode ended by itself.
        done: (T, ...) 1 where it ended, by itself or at a time limit.
        reset: (T, ...) 1 where the transition spans a reset.
        discount: γ.
        gae_lambda: λ.

    Returns:
        (T, ...) advantages; the value targets are ``advantages + values[:-1]``.
    """
    # TD error: δ_t = r_t + γ (1 − terminated_t) V(s_{t+1}) − V(s_t)
    deltas = rewards + discount * (1.0 - terminated) * values[1:] - values[:-1]
    # A_t = δ_t + γ λ (1 − done_t) A_{t+1}
    decay = discount * gae_lambda * (1.0 - done)

    def backward(later: jax.Array, row: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        delta, keep, skip = row
        advantage = jp.where(skip > 0, 0.0, delta + keep * later)
        return advantage, advantage

    _, result = jax.lax.scan(backward, jp.zeros_like(values[0]), (deltas, decay, reset), reverse=True)
    return result
