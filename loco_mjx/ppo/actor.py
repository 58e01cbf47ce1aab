"""A policy that acts: in training, in evaluation, in pictures, from Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jp

from loco_mjx.networks import hold
from loco_mjx.networks.policies import DEPTH, PRIVILEGED, STATE, Networks, Outputs, Params
from loco_mjx.ppo import distribution, frame_stack
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.normalizer import Normalizer

Act = Callable[[Mapping[str, jax.Array], jax.Array], jax.Array]


def finite(x: jax.Array) -> jax.Array:
    """The array with 0 in place of what is not finite."""
    return jp.where(jp.isfinite(x), x, 0.0)


def policy_input(obs: Mapping[str, jax.Array], normalizer: Normalizer) -> dict[str, jax.Array]:
    """An environment's observation as networks take it: finite, `state` normalised, depth as it is stored."""
    result = {STATE: normalizer_lib.normalize(normalizer, finite(obs[STATE]))}
    if DEPTH in obs:
        result[DEPTH] = frame_stack.rounded(finite(obs[DEPTH]))
    if PRIVILEGED in obs:
        result[PRIVILEGED] = finite(obs[PRIVILEGED])
    return result


@dataclass(frozen=True)
class Actor:
    """A policy with its parameters, its frozen statistics and, where it holds depth, the depth it holds.

    Whoever runs it carries the depth from step to step and says where it is taken anew (`refresh`), for there are two
    clocks. Where a policy that has learnt runs, simulated or on a robot, it is the episode's: :meth:`refreshes`. In
    training it is the window's and restarts with each episode: see loco_mjx/networks/hold.py.

    Attributes:
        networks: the policy's.
        params: their parameters.
        normalizer: statistics of `state`.
    """

    networks: Networks
    params: Params
    normalizer: Normalizer

    def first_held(self, obs: Mapping[str, jax.Array]) -> jax.Array | None:
        """What is carried before the first step: nothing that is seen; None for a policy that holds nothing."""
        return None if self.networks.hold == 1 else jp.zeros_like(obs[DEPTH])

    def refreshes(self, step: jax.Array) -> jax.Array:
        """Whether depth is taken anew at control steps of an episode, () or (...)."""
        return step % self.networks.hold == 0

    def decide(
        self, obs: Mapping[str, jax.Array], held: jax.Array | None, refresh: jax.Array
    ) -> tuple[Outputs, jax.Array | None]:
        """What the networks say, and the depth held from now on.

        Args:
            obs: an environment's, not normalised, with leading axes (...).
            held: (..., H, W, frames) depth held so far, or None.
            refresh: (...) bool, or () for all, whether depth is taken anew.
        """
        seen = hold.with_held_depth(policy_input(obs, self.normalizer), held, refresh)
        return self.networks.apply(self.params, seen), None if held is None else seen[DEPTH]

    def act(
        self, obs: Mapping[str, jax.Array], held: jax.Array | None, refresh: jax.Array, key: jax.Array | None = None
    ) -> tuple[jax.Array, jax.Array | None]:
        """(..., actions) in [−1, 1], and the depth held from now on; with a key drawn, without it the mean."""
        outputs, held = self.decide(obs, held, refresh)
        if key is None:
            return jp.tanh(outputs.mean), held
        return jp.tanh(distribution.sample(key, outputs.mean, outputs.log_std)), held


def make_inference(networks: Networks, params: Params, normalizer: Normalizer, deterministic: bool = True) -> Act:
    """A function from an environment's observation and a key to an action in [−1, 1], with depth as it is given.

    Observations are as environments return them (not normalised), with any leading axes; one key draws for all of
    them. The statistics are frozen.

    Args:
        networks: the policy's networks.
        params: their parameters.
        normalizer: statistics of `state`.
        deterministic: act by the Gaussian's mean; the key is then not used.
    """
    actor = Actor(networks, params, normalizer)

    def act(obs: Mapping[str, jax.Array], key: jax.Array) -> jax.Array:
        return actor.act(obs, None, jp.array(True), None if deterministic else key)[0]

    return act
