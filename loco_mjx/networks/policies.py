"""The policies: Flax modules from observations to an action's Gaussian and a value.

Policy and value share the encoders of state and depth; transformers and heads are separate.
A new policy is one module under :func:`register_policy`, here or in a module of the user's.
"""

from __future__ import annotations

from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jp

from loco_mjx import ranges
from loco_mjx.config import NetworkConfig
from loco_mjx.networks.encoders import MLP, PROJECTION_INIT, DepthEncoder, VisualTokens
from loco_mjx.networks.outputs import (
    DEPTH,
    STATE,
    Observation,
    Outputs,
    Params,
    heads,
    with_privileged,
)
from loco_mjx.networks.registry import POLICIES, register_policy
from loco_mjx.networks.transformer import Transformer


class PolicyModule(nn.Module):
    """What all policies' modules are made of.

    Attributes:
        config: sizes.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int


class LocoTransformer(PolicyModule):
    """State token and visual tokens through a transformer; the state token and the visual tokens' mean decide."""

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


class DepthOnly(PolicyModule):
    """The transformer over visual tokens alone; their mean decides."""

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


class StateDepthConcat(PolicyModule):
    """Flattened visual features and state features side by side, into an MLP."""

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) and `pixels/depth` (..., 64, 64, frames) to Outputs."""
        hidden = self.config.hidden
        body = MLP(hidden, name="state_encoder")(obs[STATE])
        visual = _visual_vector(obs[DEPTH], hidden[-1])
        features = jp.concatenate([visual, body], axis=-1)
        return heads(self, hidden, features, lambda: features, obs)


class VisualCnn(PolicyModule):
    """Flattened visual features alone, into an MLP: what the paper compares `depth-only` with over the MPC."""

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`pixels/depth` (..., 64, 64, frames) to Outputs."""
        features = _visual_vector(obs[DEPTH], self.config.hidden[-1])
        return heads(self, self.config.hidden, features, lambda: features, obs)


class Hierarchical(PolicyModule):
    """Two levels trained as one: vision → latent command; state and command → action (after Jain et al. 2020).

    Whoever runs the policy holds the depth it is given for `config.hold` control steps (loco_mjx/ppo/actor.py), and
    with it the command. The paper names neither the command's width nor its period; both are ours, as is training
    both levels by PPO at once and leaving out the trajectory generator.
    """

    @nn.compact
    def __call__(self, obs: Observation) -> Outputs:
        """`state` (..., n) and held `pixels/depth` (..., 64, 64, frames) to Outputs."""
        config = self.config
        visual = _visual_vector(obs[DEPTH], config.hidden[-1])
        command = nn.tanh(nn.Dense(config.latent_dim, kernel_init=PROJECTION_INIT, name="policy_command")(visual))
        body = MLP(config.hidden, name="state_encoder")(obs[STATE])
        low = jp.concatenate([body, command], axis=-1)
        return heads(self, config.hidden, low, lambda: jp.concatenate([visual, body], axis=-1), obs)


class StateOnly(PolicyModule):
    """A blind MLP; policy and value share the first half of its layers."""

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
        return with_privileged(obs)


register_policy("loco-transformer", LocoTransformer)
register_policy("state-only", StateOnly, uses_depth=False)
register_policy("depth-only", DepthOnly, uses_state=False)
register_policy("state-depth-concat", StateDepthConcat)
register_policy("visual-cnn", VisualCnn, uses_state=False)
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
