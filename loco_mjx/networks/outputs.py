"""What policies read and return: observations by name; an action's Gaussian and a value, and their heads."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import NetworkConfig
from loco_mjx.networks.encoders import MLP, Head

Observation = Mapping[str, jax.Array]
Params = Any
STATE, DEPTH, PRIVILEGED = "state", "pixels/depth", "privileged"
LOG_STD, LOG_STD_RANGE = "log_std", (-5.0, 2.0)  # the parameter's name, and where it is clipped
MEAN_SCALE, VALUE_SCALE = 0.01, 1.0  # gains of the last layers' initialisation


@struct.dataclass
class Outputs:
    """What a policy says about observations with leading axes (...).

    Attributes:
        mean: (..., actions) mean of the Gaussian, before the tanh.
        log_std: (..., actions) log standard deviation, the same for every observation.
        value: (...) estimated return.
        attention: (..., N·N) the last layer's attention from the state token to the visual tokens (what remains
            to 1 is its attention to itself), or None for policies without both.
    """

    mean: jax.Array
    log_std: jax.Array
    value: jax.Array
    attention: jax.Array | None = None


class Gaussian(nn.Module):
    """A policy head: the mean from features, and a free log standard deviation.

    Attributes:
        hidden: width of the hidden layers.
        actions: size of the action.
        initial_std: standard deviation to start from.
    """

    hidden: tuple[int, ...]
    actions: int
    initial_std: float

    @nn.compact
    def __call__(self, features: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(..., n) features to mean and log_std, (..., actions) each."""
        mean = Head(self.hidden, self.actions, MEAN_SCALE, name="mean")(features)
        start = nn.initializers.constant(math.log(self.initial_std))
        log_std = jp.clip(self.param(LOG_STD, start, (self.actions,)), *LOG_STD_RANGE)
        return mean, jp.broadcast_to(log_std, mean.shape)


class Critic(nn.Module):
    """The value by an MLP on `state` and `privileged`: shaped as the value of the policy `privileged`.

    Attributes:
        config: sizes.
    """

    config: NetworkConfig

    @nn.compact
    def __call__(self, obs: Observation) -> jax.Array:
        """`state` (..., n) and `privileged` (..., m) to the value (...)."""
        hidden = self.config.state_only_hidden
        shared = len(hidden) // 2
        features = MLP(hidden[:shared], name="state_encoder")(with_privileged(obs))
        return Head(hidden[shared:], 1, VALUE_SCALE, name="value_head")(features)[..., 0]


def with_privileged(obs: Observation) -> jax.Array:
    """`state` and `privileged` side by side, (..., n + m)."""
    return jp.concatenate([obs[STATE], obs[PRIVILEGED]], axis=-1)


def heads(
    module: Any,
    hidden: tuple[int, ...],
    policy: jax.Array,
    value: Callable[[], jax.Array],
    obs: Observation,
    attention: Any = None,
) -> Outputs:
    """Heads of policy and value on their features; called inside a compact module, which owns them.

    Args:
        module: the policy's, with `config` and `actions`.
        hidden: width of the heads' hidden layers.
        policy: features of the policy.
        value: makes those of the value; not called where a privileged critic takes its place.
        obs: what the critic looks at.
        attention: for Outputs.
    """
    config: NetworkConfig = module.config
    mean, log_std = Gaussian(hidden, module.actions, config.initial_std, name="policy_head")(policy)
    if config.critic == "privileged":
        critic = Critic(config, name="critic")
        worth = critic(obs) if PRIVILEGED in obs else jp.zeros(mean.shape[:-1])  # out of the simulator there is none
        return Outputs(mean, log_std, worth, attention)
    estimate = Head(hidden, 1, VALUE_SCALE, name="value_head")(value())[..., 0]
    return Outputs(mean, log_std, estimate, attention)
