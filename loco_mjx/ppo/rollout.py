"""Collecting a rollout: the policy acts in a batch of environments for T steps, all inside one scan."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.env import autoreset
from loco_mjx.env.state import State
from loco_mjx.networks.outputs import DEPTH, PRIVILEGED, STATE, Params
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import distribution, frame_stack
from loco_mjx.ppo.actor import Actor, Held, finite
from loco_mjx.ppo.normalizer import Normalizer

Metrics = dict[str, jax.Array]
_Carry = tuple[State, Held]  # the environments, and the depth their policy holds


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
        The environments' states, the rollout, and sums of metrics over its transitions (see :func:`_sums`).
    """
    step = jax.vmap(lambda state, action: autoreset.step(env, state, action, pool))
    actor = Actor(networks, params, normalizer)
    stored = partial(_stored, depth=networks.uses_depth)

    def body(carry: _Carry, t: jax.Array) -> tuple[_Carry, tuple[dict[str, Any], Metrics]]:
        state, held = carry
        outputs, held = actor.outputs(state.obs, held, t, restarted=state.info["reset"] > 0)
        step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
        action = jax.vmap(distribution.sample)(step_keys, outputs.mean, outputs.log_std)
        next_state = step(state, jp.tanh(action))
        transition = {
            "action": action,
            "log_prob": distribution.log_prob(action, outputs.mean, outputs.log_std),
            "value": outputs.value,
            "reward": finite(next_state.reward),
            "terminated": next_state.done * (1.0 - next_state.info["truncation"]),
            "done": next_state.done,
            "reset": next_state.info["reset"],
        }
        return (next_state, held), (transition | stored(state), _sums(next_state))

    carry = (env_state, actor.start(env_state.obs))
    (last, _), (transitions, sums) = jax.lax.scan(body, carry, jp.arange(unroll, dtype=jp.int32))
    value = actor.outputs(last.obs)[0].value
    for name, final in ({"value": value} | stored(last)).items():
        transitions[name] = jp.concatenate([transitions[name], final[None]])
    if "frames" in transitions:
        older = frame_stack.older(finite(env_state.obs[DEPTH]))
        transitions["frames"] = jp.concatenate([older, transitions["frames"]])
    return last, Rollout(**({"frames": None} | transitions)), jax.tree.map(lambda x: jp.sum(x, axis=0), sums)


def _stored(state: State, depth: bool) -> dict[str, jax.Array]:
    """The parts of an observation that the rollout keeps."""
    kept = {"state": finite(state.obs[STATE])}
    if depth:
        kept["frames"] = frame_stack.newest(finite(state.obs[DEPTH]))
    if PRIVILEGED in state.obs:
        kept[PRIVILEGED] = finite(state.obs[PRIVILEGED])
    return kept


def _sums(after: State) -> Metrics:
    """Sums over the environments after a step.

    `steps` and `step/...` are over transitions that are not resets; `episodes` and `episode/...` over episodes that
    ended. `nonfinite` counts those with a reward or a `state` that is not finite, by whomever it was caught.
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
