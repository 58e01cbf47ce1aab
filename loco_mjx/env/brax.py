"""Many environments as Brax's learners want them: batched, with a time limit, reset in the step that ends an episode.

What Brax's own VmapWrapper, EpisodeWrapper and AutoResetWrapper make of an environment, with three differences: an
episode that ends starts another one, with another start in another scene, instead of the first one again; the
environment's own time limit counts as a truncation; and a step renders once. Nothing here needs Brax.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jp

from loco_mjx.env.autoreset import ResettableEnv
from loco_mjx.env.state import State
from loco_mjx.errors import UserError

POOL_SIZE = 512  # scenes held ready for resets
# What this wrapper adds to the info beside the time limit's `truncation`; the first four are Brax's names.
_STEPS, _DONE, _SUMS, _SCENES, _KEY = "steps", "episode_done", "episode_metrics", "scenes", "reset_key"


def wrap_for_brax(
    env: ResettableEnv,
    episode_length: int = 1000,
    action_repeat: int = 1,
    randomization_fn: Any = None,
    pool_size: int = POOL_SIZE,
) -> BraxEnv:
    """A batch of environments for Brax's learners: the `wrap_env_fn` of ``brax.training.agents.ppo.train.train``.

    Args:
        env: one environment, from :func:`loco_mjx.make_env`.
        episode_length: control steps after which an episode is truncated, if not before, at its `horizon`.
        action_repeat: 1, the only value there is: a policy acts at every control step.
        randomization_fn: None, since the environment randomises by itself where its configuration says so.
        pool_size: scenes to reset into, at least; each environment brings as many as it takes. They are drawn anew at
            every ``reset`` of the batch.

    Raises:
        UserError: on any other `action_repeat` or `randomization_fn`, or sizes less than 1.
    """
    if action_repeat != 1:
        raise UserError(f"action_repeat is {action_repeat}; accepted: 1, an action for every control step")
    if randomization_fn is not None:
        raise UserError("randomization_fn is given; accepted: None, and randomization.enabled in the EnvConfig instead")
    for name, value in (("episode_length", episode_length), ("pool_size", pool_size)):
        if value < 1:
            raise UserError(f"{name} is {value}; accepted: 1 or more")
    return BraxEnv(env, episode_length, pool_size)


class BraxEnv:
    """What :func:`wrap_for_brax` returns: Brax's interface, over a batch.

    Observations in the step that ends an episode are the next episode's first, as Brax's learners expect; `reward`,
    `done`, `metrics` and ``info["truncation"]`` are those of the step. Beside these the info holds, each with a leading
    axis of environments: `steps` of the episode, `episode_metrics` (sums of the metrics since its start, with `length`
    and `sum_reward`) and `episode_done`, all three the old episode's where `done` is 1; and the `scenes` to reset into.
    """

    def __init__(self, env: ResettableEnv, episode_length: int, pool_size: int) -> None:
        """As :func:`wrap_for_brax`."""
        self.env, self.episode_length, self.pool_size = env, episode_length, pool_size

    @property
    def unwrapped(self) -> ResettableEnv:
        """The single environment."""
        return self.env

    @property
    def action_size(self) -> int:
        """Dimension of one environment's action."""
        return self.env.action_size

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        """Shape of each part of one environment's observation."""
        return self.env.observation_size

    def reset(self, keys: jax.Array) -> State:
        """The first states of as many episodes as there are keys, each in a scene of its own.

        Args:
            keys: (N, ...) one per environment.
        """
        count = keys.shape[0]
        share = -(-self.pool_size // count)
        pool = self.env.make_pool(jax.random.fold_in(keys[0], count), count * share)
        scenes = jax.tree.map(lambda leaf: leaf.reshape(count, share, *leaf.shape[1:]), pool)
        return jax.vmap(self._first)(keys, scenes)

    def step(self, state: State, action: jax.Array) -> State:
        """One control step of every environment.

        Args:
            state: as :meth:`reset` or this method returned it.
            action: (N, action_size) in [−1, 1].
        """
        info = dict(state.info)
        scenes = info.pop(_SCENES)
        pool = jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:]), scenes)
        after = jax.vmap(self._step, in_axes=(0, 0, None))(state.replace(info=info), action, pool)
        return after.replace(info=after.info | {_SCENES: scenes})

    # One environment ------------------------------------------------------------------------------------------------

    def _first(self, key: jax.Array, scenes: Any) -> State:
        start_key, reset_key = jax.random.split(key)
        state = self.env.observe(self.env.reset_to(start_key, jax.tree.map(lambda leaf: leaf[0], scenes)))
        zero = jp.zeros(())
        sums = dict.fromkeys([*state.metrics, "sum_reward", "length"], zero)
        ours = {_KEY: reset_key, _STEPS: zero, _DONE: zero, _SUMS: sums, _SCENES: scenes}
        return state.replace(info=state.info | ours)

    def _step(self, state: State, action: jax.Array, pool: Any) -> State:
        after = self._limited(state, self.env.advance(state, action))
        key, scene_key, start_key = jax.random.split(after.info[_KEY], 3)
        fresh = self.env.reset_to(start_key, self.env.draw(scene_key, pool))
        # What the fresh state does not have is ours or another wrapper's; `truncation` says how the old episode ended.
        begun = {name: value for name, value in fresh.info.items() if name != "truncation"}
        old = (after.pipeline_state, after.obs, {name: after.info[name] for name in begun})
        new = (fresh.pipeline_state, fresh.obs, begun)
        world, obs, info = jax.tree.map(lambda a, b: jp.where(after.done > 0, a, b), new, old)
        return self.env.observe(after.replace(pipeline_state=world, obs=obs, info=after.info | info | {_KEY: key}))

    def _limited(self, before: State, after: State) -> State:
        """The time limit, and the sums over the episode so far; a step after `done` is a new episode's first."""
        going_on = 1.0 - before.info[_DONE]
        steps = before.info[_STEPS] * going_on + 1.0
        late = (steps >= self.episode_length).astype(after.done.dtype)
        truncation = jp.where(after.done > 0, after.info["truncation"], late)
        done = jp.maximum(after.done, late)
        values = after.metrics | {"sum_reward": after.reward, "length": jp.ones(())}
        sums = {name: total * going_on + values[name] for name, total in before.info[_SUMS].items()}
        ours = {"truncation": truncation, _STEPS: steps, _DONE: done, _SUMS: sums}
        return after.replace(done=done, info=after.info | ours)
