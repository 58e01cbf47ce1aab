"""Loads the policy of a run."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jp
from jax.sharding import SingleDeviceSharding

from loco_mjx.config import Config
from loco_mjx.env import observation
from loco_mjx.errors import UserError
from loco_mjx.networks.policies import Networks, make_networks
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.actor import Actor
from loco_mjx.run import checkpoint, directory, needs


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy as a run left it.

    Attributes:
        config: the run's configuration.
        networks: its networks.
        params: their parameters.
        normalizer: statistics of its input, frozen.
        samples: it was trained on.
    """

    config: Config
    networks: Networks
    params: Any
    normalizer: normalizer_lib.Normalizer
    samples: int

    def actor(self, deterministic: bool = True) -> Actor:
        """The policy acting, by its mean or by drawing from its Gaussian."""
        return Actor(self.networks, self.params, self.normalizer, deterministic)


def load_policy(path: Path, step: int | str | None = None) -> TrainedPolicy:
    """The policy of the run in a directory.

    Args:
        path: the directory.
        step: the samples trained at the checkpoint to take, or "best"; None: the newest.

    Raises:
        UserError: if there is no run, no checkpoint yet, or none that can be read.
    """
    config = directory.load_config(path)
    needs.check(config, path)
    networks = make_networks(config.policy, config.network, config.env.action_size)
    template = _template(config, networks)
    at = None if step is None else checkpoint.choose(path, step)
    restored = checkpoint.restore(path, template, config, _to_stderr, checkpoint.POLICY, at)
    if restored is None:
        raise UserError(f"the run in {path} has no checkpoint yet; let `loco-mjx train` go on until it has saved one")
    policy, samples = restored
    return TrainedPolicy(config, networks, policy["params"], policy["normalizer"], samples)


def observation_shapes(config: Config) -> dict[str, tuple[int, ...]]:
    """Shape of each part of the observation of a configuration's environment."""
    return observation.shapes(config.env.observation)


def parameter_shapes(config: Config, networks: Networks) -> Any:
    """Shapes and types of a policy's parameters, as a pytree of ShapeDtypeStruct."""
    obs = {name: jp.zeros((1, *shape)) for name, shape in observation_shapes(config).items()}
    return jax.eval_shape(lambda: networks.init(jax.random.PRNGKey(0), obs))


def _template(config: Config, networks: Networks) -> Any:
    """Shapes and types of what a checkpoint holds of a policy, on the first device."""
    normalizer = jax.eval_shape(lambda: normalizer_lib.create(observation_shapes(config)["state"][0]))
    policy = {"params": parameter_shapes(config, networks), "normalizer": normalizer}
    place = SingleDeviceSharding(jax.local_devices()[0])
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=place), policy)


def _to_stderr(text: str) -> None:
    print(f"loco-mjx: {text}", file=sys.stderr)
