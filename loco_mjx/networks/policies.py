"""The policies: Flax modules from observations to an action's Gaussian and a value.

Policy and value share the encoders of state and depth; transformers and heads are separate.
A new policy is one module under :func:`register_policy`, here or in a module of the user's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import flax.linen as nn
import jax
import jax.numpy as jp
from flax import struct

from loco_mjx import ranges
from loco_mjx.config import NetworkConfig
from loco_mjx.networks.encoders import MLP, PROJECTION_INIT, DepthEncoder, Head, VisualTokens
from loco_mjx.networks.transformer import Transformer
from loco_mjx.registry import Registry, caller

Observation = Mapping[str, jax.Array]
Params = Any
STATE, DEPTH, PRIVILEGED = "state", "pixels/depth", "privileged"
LOG_STD_RANGE = (-5.0, 2.0)
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
        log_std = jp.clip(self.param("log_std", start, (self.actions,)), *LOG_STD_RANGE)
        return mean, jp.broadcast_to(log_std, mean.shape)


class Critic(nn.Module):
    """The value by an MLP on `state` and `privileged`: shaped as the value of the policy `privileged`.

    Attributes:
        config: sizes.
    """

    config: NetworkConfig

    @nn.compact
    def __call__(self, obs: Observation) -> jax.Array:
        """`state` (..., n) and `privileged` (..., m) to the value (...); 0 where there is no `privileged`."""
        if PRIVILEGED not in obs:
            return jp.zeros(obs[STATE].shape[:-1])
        hidden = self.config.state_only_hidden
        shared = len(hidden) // 2
        features = MLP(hidden[:shared], name="state_encoder")(_with_privileged(obs))
        return Head(hidden[shared:], 1, VALUE_SCALE, name="value_head")(features)[..., 0]


def _with_privileged(obs: Observation) -> jax.Array:
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
        return Outputs(mean, log_std, Critic(config, name="critic")(obs), attention)
    estimate = Head(hidden, 1, VALUE_SCALE, name="value_head")(value())[..., 0]
    return Outputs(mean, log_std, estimate, attention)


class LocoTransformer(nn.Module):
    """State token and visual tokens through a transformer; the state token and the visual tokens' mean decide.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) and `pixels/depth` (..., 64, 64, frames) to Outputs."""
        config = self.config
        body = MLP(config.hidden, name="state_encoder")(obs[STATE])
        body = nn.relu(nn.Dense(config.token_dim, kernel_init=PROJECTION_INIT, name="state_token")(body))
        features = DepthEncoder(name="depth_encoder")(obs[DEPTH])
        visual = VisualTokens(config.token_dim, config.tokens_per_side, name="visual_tokens")(features)
        tokens = jp.concatenate([body[..., None, :], visual], axis=-2)  # (..., 1 + N·N, C)
        policy, attention = self._branch("policy", tokens)
        attention = None if attention is None else attention[..., 0, 1:]  # (..., N·N)
        return heads(self, config.hidden, policy, lambda: self._branch("value", tokens)[0], obs, attention)

    def _branch(self, name: str, tokens: jax.Array) -> tuple[jax.Array, jax.Array | None]:
        transformer = Transformer(self.config.layers, self.config.mlp_dim, name=f"{name}_transformer")
        tokens, attention = transformer(tokens)
        pooled = jp.concatenate([tokens[..., 0, :], tokens[..., 1:, :].mean(-2)], axis=-1)  # (..., 2 C)
        return pooled, attention


class DepthOnly(nn.Module):
    """The transformer over visual tokens alone; their mean decides.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`pixels/depth` (..., 64, 64, frames) to Outputs."""
        config = self.config
        features = DepthEncoder(name="depth_encoder")(obs[DEPTH])
        tokens = VisualTokens(config.token_dim, config.tokens_per_side, name="visual_tokens")(features)

        def branch(name: str) -> jax.Array:
            return Transformer(config.layers, config.mlp_dim, name=f"{name}_transformer")(tokens)[0].mean(-2)

        return heads(self, config.hidden, branch("policy"), lambda: branch("value"), obs)


def _visual_vector(depth: jax.Array, width: int) -> jax.Array:
    """The visual features as one vector (..., width); its layers belong to the module that calls."""
    visual = DepthEncoder(name="depth_encoder")(depth)
    visual = visual.reshape(*visual.shape[:-3], -1)  # (..., 1024)
    return nn.relu(nn.Dense(width, kernel_init=PROJECTION_INIT, name="visual_projection")(visual))


class StateDepthConcat(nn.Module):
    """Flattened visual features and state features side by side, into an MLP.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) and `pixels/depth` (..., 64, 64, frames) to Outputs."""
        hidden = self.config.hidden
        body = MLP(hidden, name="state_encoder")(obs[STATE])
        visual = _visual_vector(obs[DEPTH], hidden[-1])
        features = jp.concatenate([visual, body], axis=-1)
        return heads(self, hidden, features, lambda: features, obs)


class Hierarchical(nn.Module):
    """Two levels trained as one: vision → latent command; state and command → action (after Jain et al. 2020).

    Whoever runs the policy holds the depth it is given for `config.hold` control steps (loco_mjx/ppo/actor.py), and
    with it the command. The paper names neither the command's width nor its period; both are ours, as is training
    both levels by PPO at once and leaving out the trajectory generator.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) and held `pixels/depth` (..., 64, 64, frames) to Outputs."""
        config = self.config
        visual = _visual_vector(obs[DEPTH], config.hidden[-1])
        command = nn.tanh(nn.Dense(config.latent_dim, kernel_init=PROJECTION_INIT, name="policy_command")(visual))
        body = MLP(config.hidden, name="state_encoder")(obs[STATE])
        low = jp.concatenate([body, command], axis=-1)
        return heads(self, config.hidden, low, lambda: jp.concatenate([visual, body], axis=-1), obs)


class StateOnly(nn.Module):
    """A blind MLP; policy and value share the first half of its layers.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) to Outputs."""
        hidden = self.config.state_only_hidden
        shared = len(hidden) // 2
        features = MLP(hidden[:shared], name="state_encoder")(self.inputs(obs))
        return heads(self, hidden[shared:], features, lambda: features, obs)

    def inputs(self, obs: Observation) -> jax.Array:
        """What it reads, (..., n)."""
        return obs[STATE]


class Privileged(StateOnly):
    """StateOnly that also reads what only a simulator knows: the teacher of method `distill`."""

    def inputs(self, obs: Observation) -> jax.Array:
        """`state` and `privileged` side by side, (..., n + m)."""
        return _with_privileged(obs)


@dataclass(frozen=True)
class Policy:
    """An entry of POLICIES.

    Attributes:
        build: module from (NetworkConfig, size of the action).
        uses_state: whether it reads `state`.
        uses_depth: whether it reads `pixels/depth`.
        holds: whether the depth it is given is held for NetworkConfig.hold control steps.
        uses_privileged: whether it reads `privileged`, and so never leaves the simulator.
    """

    build: Callable[[NetworkConfig, int], nn.Module]
    uses_state: bool = True
    uses_depth: bool = True
    holds: bool = False
    uses_privileged: bool = False


Build = TypeVar("Build", bound=Callable[[NetworkConfig, int], nn.Module])
POLICIES: Registry[Policy] = Registry("policy")


@overload
def register_policy(
    name: str, *, uses_state: bool = True, uses_depth: bool = True, holds: bool = False, uses_privileged: bool = False
) -> Callable[[Build], Build]: ...


@overload
def register_policy(
    name: str,
    build: Build,
    *,
    uses_state: bool = True,
    uses_depth: bool = True,
    holds: bool = False,
    uses_privileged: bool = False,
) -> Build: ...


def register_policy(
    name: str,
    build: Any = None,
    *,
    uses_state: bool = True,
    uses_depth: bool = True,
    holds: bool = False,
    uses_privileged: bool = False,
) -> Any:
    """Adds a policy: as a decorator of its module's class, or called with what makes the module.

    ``@register_policy("mine", uses_depth=False)`` above ``class Mine(nn.Module)`` with the attributes ``config`` and
    ``actions``, whose ``__call__`` takes observations with any leading axes and returns :class:`Outputs`;
    :func:`heads` makes them from features. Parameters that only the value depends on have names that begin with
    ``value_``: optimisers and exports tell them by it.

    Args:
        name: of letters, digits, `.`, `_` and `-`.
        build: module from (NetworkConfig, size of the action).
        uses_state: see :class:`Policy`, as for the others.
        uses_depth: without it nothing is rendered.
        holds: whether depth is held for `network.hold` control steps.
        uses_privileged: whether it reads what only a simulator knows.

    Raises:
        UserError: if the name is taken or no name.
    """
    origin = caller()

    def register(build: Any) -> Any:
        POLICIES.register(name, Policy(build, uses_state, uses_depth, holds, uses_privileged), origin)
        return build

    return register if build is None else register(build)


register_policy("loco-transformer", LocoTransformer)
register_policy("state-only", StateOnly, uses_depth=False)
register_policy("depth-only", DepthOnly, uses_state=False)
register_policy("state-depth-concat", StateDepthConcat)
register_policy("hrl", Hierarchical, holds=True)
register_policy("privileged", Privileged, uses_depth=False, uses_privileged=True)


@dataclass(frozen=True)
class Networks:
    """A policy's module and which parts of the observation it reads.

    Attributes:
        module: from observations (with any leading axes) to Outputs.
        uses_state: whether it reads `state`.
        uses_depth: whether it reads `pixels/depth`.
        hold: control steps for which the depth it is given is held; 1: it sees every frame.
        uses_privileged: whether the policy or its critic reads `privileged`.
    """

    module: nn.Module
    uses_state: bool
    uses_depth: bool
    hold: int = 1
    uses_privileged: bool = False

    def init(self, key: jax.Array, obs: Observation) -> Params:
        """Parameters for observations shaped like `obs` (`state` already normalised)."""
        return self.module.init(key, obs)

    def apply(self, params: Params, obs: Observation) -> Outputs:
        """Outputs for observations (`state` already normalised) with any leading axes."""
        return self.module.apply(params, obs)  # type: ignore[return-value]


def make_networks(policy: str, config: NetworkConfig, action_size: int) -> Networks:
    """The networks of a policy in POLICIES.

    Raises:
        UnknownNameError: if there is no policy of that name.
        UserError: if a size is not one the networks can be built with.
    """
    entry = POLICIES.find(policy)
    ranges.check(config, "network")
    hold = config.hold if entry.holds else 1
    knows = entry.uses_privileged or config.critic == "privileged"
    return Networks(entry.build(config, action_size), entry.uses_state, entry.uses_depth, hold, knows)
