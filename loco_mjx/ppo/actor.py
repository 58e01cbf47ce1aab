"""Acting with a policy: its input made of an observation, and the depth that it holds between control steps.

A policy may hold the depth that it sees for several control steps, so that what it decides from depth lasts as long
(`hrl`). The clock is whoever steps it: in training the rollout's step t, when the policy is run the episode's. Depth is
read anew where t mod hold = 0 and at an episode's first step. What was held at any step of a rollout is therefore known
from t and the episode's start (:func:`held_since`), and recomputed log-probabilities match.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jp

from loco_mjx.networks.outputs import DEPTH, PRIVILEGED, STATE, Outputs, Params
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import distribution, frame_stack
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.normalizer import Normalizer

Observation = Mapping[str, jax.Array]
Held = jax.Array | None  # (..., H, W, frames) depth that a policy holds; None for one that holds nothing


def finite(x: jax.Array) -> jax.Array:
    """The array with 0 in place of what is not finite."""
    return jp.where(jp.isfinite(x), x, 0.0)


def policy_input(obs: Observation, normalizer: Normalizer) -> dict[str, jax.Array]:
    """What an observation has, as networks take it: finite, `state` normalised, depth as it is stored."""
    result = {}
    if STATE in obs:
        result[STATE] = normalizer_lib.normalize(normalizer, finite(obs[STATE]))
    if DEPTH in obs:
        result[DEPTH] = frame_stack.rounded(finite(obs[DEPTH]))
    if PRIVILEGED in obs:
        result[PRIVILEGED] = finite(obs[PRIVILEGED])
    return result


@dataclass(frozen=True)
class Actor:
    """A policy that acts, one control step after the other.

    Observations are as environments return them (not normalised), with any leading axes. The statistics are frozen.

    Attributes:
        networks: the policy's networks.
        params: their parameters.
        normalizer: statistics of `state`.
        deterministic: act by the Gaussian's mean.
    """

    networks: Networks
    params: Params
    normalizer: Normalizer
    deterministic: bool = True

    def start(self, obs: Observation) -> Held:
        """What is held before the first step; step 0 of the clock replaces it."""
        return None if self.networks.hold == 1 else jp.zeros_like(obs[DEPTH])

    def outputs(
        self, obs: Observation, held: Held = None, step: jax.Array | int = 0, restarted: jax.Array | bool = False
    ) -> tuple[Outputs, Held]:
        """What the networks make of an observation, and the depth that is held from now on.

        Args:
            obs: the newest observation.
            held: of the step before; None: the networks see the depth of `obs`.
            step: () of the clock.
            restarted: (...) or () bool, whether an episode begins here.
        """
        inputs = policy_input(obs, self.normalizer)
        if held is not None:
            refresh = (step % self.networks.hold == 0) | jp.asarray(restarted)
            refresh = jp.reshape(refresh, (*refresh.shape, *(1,) * (held.ndim - refresh.ndim)))
            inputs[DEPTH] = held = jp.where(refresh, inputs[DEPTH], held)
        return self.networks.apply(self.params, inputs), held

    def act(
        self, obs: Observation, held: Held = None, step: jax.Array | int = 0, key: jax.Array | None = None
    ) -> tuple[jax.Array, Held]:
        """An action in [−1, 1], and the depth that is held from now on; one key draws for all leading axes."""
        outputs, held = self.outputs(obs, held, step)
        if self.deterministic:
            return jp.tanh(outputs.mean), held
        assert key is not None
        return jp.tanh(distribution.sample(key, outputs.mean, outputs.log_std)), held


def held_since(step: jax.Array, start: jax.Array, hold: int) -> jax.Array:
    """Step of a rollout whose depth the policy saw at a step.

    Args:
        step: int32 steps of the rollout.
        start: of the same shape, the step at which each one's episode started; negative if before the rollout.
        hold: control steps for which depth is held.
    """
    return jp.maximum(step - step % hold, start)
