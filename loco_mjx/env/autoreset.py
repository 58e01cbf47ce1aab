"""Next-step autoreset: the step after `done` starts a new episode in a new scene.

The terminal observation is therefore real, so bootstrapping at a time limit is exact; the one transition that spans the
reset carries ``info["reset"] = 1`` and is to be left out of the loss. (Gymnasium: ``AutoresetMode.NEXT_STEP``.)
"""

from __future__ import annotations

from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jp

from loco_mjx.env.masked_reset import masked_reset
from loco_mjx.env.state import State


class ResettableEnv(Protocol):
    """What the learner needs of an environment; :class:`loco_mjx.env.loco_env.LocoEnv` is one."""

    @property
    def action_size(self) -> int: ...

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]: ...

    def make_pool(self, key: jax.Array, size: int) -> Any: ...

    def draw(self, key: jax.Array, scenes: Any) -> Any: ...

    def reset_to(self, key: jax.Array, scene: Any) -> State: ...

    def advance(self, state: State, action: jax.Array) -> State: ...

    def observe(self, state: State) -> State: ...


def _reset_from_pool(env: ResettableEnv, key: jax.Array, pool: Any) -> State:
    scene_key, start_key, reset_key = jax.random.split(key, 3)
    fresh = env.reset_to(start_key, env.draw(scene_key, pool))
    sums = {name: jp.zeros(()) for name in fresh.metrics} | {"length": jp.zeros(()), "return": jp.zeros(())}
    return fresh.replace(info=fresh.info | {"reset": jp.ones(()), "reset_key": reset_key, "episode": sums})


def first(env: ResettableEnv, key: jax.Array, pool: Any) -> State:
    """The first state of one environment.

    Adds to ``info``: `reset` (1 on the first state of an episode), `episode` (sums of the metrics since the reset, with
    `length` and `return`; an episode's figures where `done` is 1) and `reset_key`.
    """
    return env.observe(_reset_from_pool(env, key, pool))


def step(env: ResettableEnv, state: State, action: jax.Array, pool: Any) -> State:
    """One control step, or, where the state is done, the first state of a new episode (the action is ignored).

    Renders once either way.

    Args:
        env: the environment.
        state: as :func:`first` or this function returned it.
        action: (action_size,) in [−1, 1].
        pool: scenes to reset into, as ``env.make_pool`` made them.
    """
    stepped = env.advance(state, action)
    sums = {name: state.info["episode"][name] + value for name, value in stepped.metrics.items()}
    sums["length"] = state.info["episode"]["length"] + 1.0
    sums["return"] = state.info["episode"]["return"] + stepped.reward
    stepped = stepped.replace(info=stepped.info | {"reset": jp.zeros(()), "episode": sums})
    reset = partial(_reset_from_pool, env)
    return env.observe(masked_reset(reset, state.done > 0, state.info["reset_key"], stepped, pool))
