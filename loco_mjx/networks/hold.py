"""Holding depth: a policy's command that lasts several control steps is depth that stands still for as long.

In training the clock is the window's: depth is taken anew at every step t of a window with t mod hold = 0 and at an
episode's first step, so that what was held at any step is known from t and the episode's start alone, and recomputed
log-probabilities match. When a policy is run, the clock is the episode's. Both go through loco_mjx/ppo/actor.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jp

from loco_mjx.networks.policies import DEPTH


def with_held_depth(obs: Mapping[str, jax.Array], held: jax.Array | None, refresh: jax.Array) -> dict[str, jax.Array]:
    """The observation with its depth taken anew where asked, and held elsewhere.

    Args:
        obs: observations with leading axes (...).
        held: (..., H, W, frames) depth of the last step, or None for a policy that holds nothing.
        refresh: (...) bool, or () for all of them.
    """
    if held is None:
        return dict(obs)
    shape = (*jp.shape(refresh), *(1,) * (held.ndim - jp.ndim(refresh)))
    return dict(obs) | {DEPTH: jp.where(jp.reshape(refresh, shape), obs[DEPTH], held)}


def refresh_step(step: jax.Array, start: jax.Array, hold: int) -> jax.Array:
    """Step of the window at which the depth of a step was taken.

    Args:
        step: int32 steps of a window.
        start: of the same shape, the step at which each one's episode started; negative if before the window.
        hold: control steps for which depth is held.
    """
    return jp.maximum(step - step % hold, start)
