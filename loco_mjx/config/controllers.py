"""What a controller makes of a configuration."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from loco_mjx.config.tree import Config
from loco_mjx.controllers import get_controller

# Keys and values that come with a controller; with any other they are the configuration's defaults. The whole-body
# controller's are the paper's and, of the observation, the authors' code's (docs/whole_body.md).
OWN: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "mpc": {
            "env.horizon": 500,
            "env.observation.state_frames": 1,
            "env.observation.displacement": False,
            "env.observation.velocity": True,
            "env.observation.attitude": True,
            "env.observation.imu": False,
            "env.observation.last_action": False,
            "env.observation.angles": False,
            "env.reward.forward": 0.5,
            "env.reward.energy": 0.0,
            "env.randomization.enabled": False,
            "ppo.num_envs": 128,  # × unroll 32: 4,096 samples an iteration
        }
    }
)


def with_controller(config: Config, name: str) -> Config:
    """The configuration for a controller: with what comes with it in place of what came with the former one.

    Raises:
        UnknownNameError: if there is no controller of that name.
    """
    get_controller(name)
    if name == config.env.controller:
        return config
    former = {key: _value(Config(), key) for key in OWN.get(config.env.controller, {})}
    for key, value in (former | dict(OWN.get(name, {})) | {"env.controller": name}).items():
        config = _replaced(config, key, value)
    return config


def _value(tree: Any, key: str) -> Any:
    for name in key.split("."):
        tree = getattr(tree, name)
    return tree


def _replaced(tree: Any, key: str, value: Any) -> Any:
    """A tree of frozen dataclasses with one value changed."""
    name, _, rest = key.partition(".")
    return dataclasses.replace(tree, **{name: _replaced(getattr(tree, name), rest, value) if rest else value})
