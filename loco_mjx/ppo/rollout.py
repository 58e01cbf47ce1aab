"""Collecting a window of experience: the policy acts in a batch of environments, all inside one scan."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.env import autoreset
from loco_mjx.env.state import State
from loco_mjx.networks.policies import DEPTH, PRIVILEGED, STATE, Networks, Params
from loco_mjx.ppo import distribution, frame_stack
from loco_mjx.ppo.actor import Actor, finite, policy_input
from loco_mjx.ppo.normalizer import Normalizer

Metrics = dict[str, jax.Array]
_Carry = tuple[State, jax.Array | None]  # the environments, and the depth their policy holds


@struct.dataclass
class Rollout:
    """T steps of B environments, time-major. Transition t goes from observation t to observation t+1.

    Attributes:
        state: (T+1, B, n) `state` observations, not normalised.
        frames: (K+T, B, H, W) depth frames as :mod:`loco_mjx.ppo.frame_stack` stores them, or None without depth.
        action: (T, B, actions) as drawn, before the tanh.
        log_prob: (T, B) of those actions.
        value: (T+1, B) the policy's value estimates.
        reward: (T, B).
        terminated: (T, B) 1 where the episode ended by itself.
        done: (T, B) 1 where it ended, by itself or at the time limit.
        reset: (T, B) 1 where the transition spans a reset; it is not to be learnt from.
        privileged: (T+1, B, m) `privileged` observations, or None where nobody reads them.
    """

    state: jax.Array
    frames: jax.Array | None
    action: jax.Array
    log_prob: jax.Array
    value: jax.Array
    reward: jax.Array
    terminated: jax.Array
    done: jax.Array
    reset: jax.Array
    privileged: jax.Array | None = None

    @property
    def weight(self) -> jax.Array:
        """(T, B) 1, or 0 for transitions that span a reset."""
        return 1.0 - self.reset


def collect(
    env: autoreset.ResettableEnv,
    networks: Networks,
    params: Params,
    normalizer: Normalizer,
    env_state: State,
    pool: Any,
    keys: jax.Array,
    unroll: int,
) -> tuple[State, Rollout, Metrics]:
    """Runs the policy for `unroll` steps.

    Args:
        env: one environment; this function vmaps it.
        networks: the policy's networks.
        params: their parameters.
        normalizer: statistics for the policy's input.
        env_state: (B,) batched states, from :func:`loco_mjx.env.autoreset.first`.
        pool: scenes to reset into.
        keys: (B, ...) one key per environment, for its actions.
        unroll: T.

    Returns:
        The environments' states, the experience, and sums of metrics over the window's rows (see :func:`_sums`).
    """
    step = jax.vmap(lambda state, action: autoreset.step(env, state, action, pool))
    stored = partial(_stored, depth=networks.uses_depth)
    actor = Actor(networks, params, normalizer)

    def body(carry: _Carry, t: jax.Array) -> tuple[_Carry, tuple[dict[str, Any], Metrics]]:
        state, held = carry
        refresh = actor.refreshes(t) | (state.info["reset"] > 0)  # on the window's clock
        outputs, held = actor.decide(state.obs, held, refresh)
        step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
        action = jax.vmap(distribution.sample)(step_keys, outputs.mean, outputs.log_std)
        after = step(state, jp.tanh(action))
        row = {
            "action": action,
            "log_prob": distribution.log_prob(action, outputs.mean, outputs.log_std),
            "value": outputs.value,
            "reward": finite(after.reward),
            "terminated": after.done * (1.0 - after.info["truncation"]),
            "done": after.done,
            "reset": after.info["reset"],
        }
        return (after, held), (row | stored(state), _sums(after))

    start = (env_state, actor.first_held(env_state.obs))
    (last, _), (rows, sums) = jax.lax.scan(body, start, jp.arange(unroll, dtype=jp.int32))
    value = networks.apply(params, policy_input(last.obs, normalizer)).value
    for name, final in ({"value": value} | stored(last)).items():
        rows[name] = jp.concatenate([rows[name], final[None]])
    if "frames" in rows:
        rows["frames"] = jp.concatenate([frame_stack.older(finite(env_state.obs[DEPTH])), rows["frames"]])
    return last, Rollout(**({"frames": None} | rows)), jax.tree.map(lambda x: jp.sum(x, axis=0), sums)


def _stored(state: State, depth: bool) -> dict[str, jax.Array]:
    """What is kept of the observations."""
    kept = {"state": finite(state.obs[STATE])}
    if depth:
        kept["frames"] = frame_stack.newest(finite(state.obs[DEPTH]))
    if PRIVILEGED in state.obs:
        kept[PRIVILEGED] = finite(state.obs[PRIVILEGED])
    return kept


def _sums(after: State) -> Metrics:
    """Sums over the environments after a step.

    `steps` and `step/...` are over rows that are not resets; `episodes` and `episode/...` over episodes that ended;
    `nonfinite` counts rows with a non-finite reward or `state`, whether the environment caught it or this function did.
    """
    taken, ended = after.info["reset"] == 0, after.done > 0
    broken = ~jp.isfinite(after.reward) | ~jp.all(jp.isfinite(after.obs[STATE]), axis=-1)
    if "nonfinite" in after.metrics:
        broken |= after.metrics["nonfinite"] > 0
    sums = {"steps": taken, "episodes": ended, "nonfinite": broken, "step/reward": jp.where(taken, after.reward, 0.0)}
    for name, value in after.metrics.items():
        sums[f"step/{name}"] = jp.where(taken, value, 0.0)
    for name, value in after.info["episode"].items():
        sums[f"episode/{name}"] = jp.where(ended, value, 0.0)
    return {name: jp.sum(finite(value.astype(jp.float32))) for name, value in sums.items()}


def averages(sums: Metrics) -> Metrics:
    """Sums as :func:`collect` returns them (added up over devices) to means; 0 where there is nothing to average.

    `episodes` and `nonfinite` stay counts.
    """
    means = {"episodes": sums["episodes"], "nonfinite": sums["nonfinite"]}
    for name, total in sums.items():
        if "/" in name:
            count = sums["steps"] if name.startswith("step/") else sums["episodes"]
            means[name] = total / jp.maximum(count, 1.0)
    return means
