"""Policies with random parameters, as a run would leave them, and observations such as environments give."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.config import ActionConfig, Config, EnvConfig, NetworkConfig, with_method
from loco_mjx.depth.encoding import encode
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo.normalizer import Normalizer
from loco_mjx.run.policy import TrainedPolicy, observation_shapes

NETWORK = NetworkConfig(token_dim=32, mlp_dim=48, hidden=(48, 40), state_only_hidden=(48, 40, 32, 24))


def policy(name: str, diagonal: bool = False, **network: Any) -> TrainedPolicy:
    action = ActionConfig(scale=(0.2, 0.5, 0.4), diagonal=diagonal)
    config = Config(policy=name, env=EnvConfig(action=action), network=dataclasses.replace(NETWORK, **network))
    config = with_method(config)
    networks = make_networks(name, config.network, action.size)
    shapes = observation_shapes(config)
    obs = {part: jp.zeros(shape) for part, shape in shapes.items()}
    rng = np.random.default_rng(2)
    params = jax.tree_util.tree_map_with_path(
        lambda path, shape: _parameter(rng, path[-1].key, shape.shape),
        jax.eval_shape(networks.init, jax.random.PRNGKey(1), obs),
    )
    count, squares = 50.0, 50.0 * rng.uniform(0.1, 2.0, 93) ** 2
    normalizer = Normalizer(*(jp.asarray(x, jp.float32) for x in (count, rng.normal(0, 0.3, 93), squares)))
    return TrainedPolicy(config, networks, params, normalizer, samples=1234)


def _parameter(rng: np.random.Generator, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Such that an error anywhere shows, in the last layer and the biases too, which begin at zero or close to it."""
    std = np.prod(shape[:-1]) ** -0.5 if name == "kernel" else 0.05  # a layer's outputs are as large as its inputs
    return np.asarray((name == "scale") + std * rng.normal(size=shape), np.float32)


def observations(count: int) -> dict[str, np.ndarray]:
    """States some of whose numbers are beyond the clip, depth of smooth surfaces with steps and holes."""
    rng = np.random.default_rng(3)
    state = rng.normal(0.0, 1.0, (count, 93)) * rng.choice([1.0, 30.0], (count, 93), p=[0.97, 0.03])
    rows = np.linspace(0.3, 1.0, 64)[:, None, None]
    depth = rng.uniform(0.3, 10.0, (count, 1, 1, 4)) * rows + rng.uniform(0, 0.2, (count, 64, 64, 4))
    depth[:, :, 20:40] = np.where(rng.uniform(size=(count, 1, 1, 4)) < 0.5, 1.0, depth[:, :, 20:40])
    return {"state": state.astype(np.float32), "depth": np.asarray(encode(jp.clip(depth, 0.3, 10.0)), np.float32)}
