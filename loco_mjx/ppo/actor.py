"""Acting with a trained policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jp

from loco_mjx.networks.policies import Networks, Params
from loco_mjx.ppo import distribution
from loco_mjx.ppo.normalizer import Normalizer
from loco_mjx.ppo.rollout import policy_input

Act = Callable[[Mapping[str, jax.Array], jax.Array], jax.Array]


def make_inference(networks: Networks, params: Params, normalizer: Normalizer, deterministic: bool = True) -> Act:
    """A function from an environment's observation and a key to an action in [−1, 1].

    Observations are as environments return them (not normalised), with any leading axes; one key draws for all of
    them. The statistics are frozen.

    Args:
        networks: the policy's networks.
        params: their parameters.
        normalizer: statistics of `state`.
        deterministic: act by the Gaussian's mean; the key is then not used.
    """

    def act(obs: Mapping[str, jax.Array], key: jax.Array) -> jax.Array:
        outputs = networks.apply(params, policy_input(obs, normalizer))
        if deterministic:
            return jp.tanh(outputs.mean)
        return jp.tanh(distribution.sample(key, outputs.mean, outputs.log_std))

    return act
