"""Holding what a policy sees: a command that lasts several control steps is depth that stands still for as long.

In training the clock is the window's: a new view is taken at every step t of a window with t mod hold = 0 and at an
episode's first step, so that what was held at any step is known from t and the episode's start alone, and recomputed
log-probabilities match. When a policy is run, the clock starts with the episode.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jp

from loco_mjx.networks.policies import DEPTH


def view(obs: Mapping[str, jax.Array], held: jax.Array | None, due: jax.Array) -> dict[str, jax.Array]:
    """The observation with its depth taken anew where due, and held elsewhere.

    Args:
        obs: observations with leading axes (...).
        held: (..., H, W, frames) depth seen at the last step, or None for a policy that holds nothing.
        due: (...) bool, or () for all of them.
    """
    if held is None:
        return dict(obs)
    shape = (*jp.shape(due), *(1,) * (held.ndim - jp.ndim(due)))
    return dict(obs) | {DEPTH: jp.where(jp.reshape(due, shape), obs[DEPTH], held)}


def seen_step(step: jax.Array, start: jax.Array, hold: int) -> jax.Array:
    """Step of the window whose depth was seen at a step.

    Args:
        step: int32 steps of a window.
        start: of the same shape, the step at which each one's episode started; negative if before the window.
        hold: control steps a view is held.
    """
    return jp.maximum(step - step % hold, start)
