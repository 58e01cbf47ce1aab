"""The configuration: the tree of its values, presets, what methods make of it, checks, and JSON."""

from loco_mjx.config.checks import check
from loco_mjx.config.controllers import with_controller
from loco_mjx.config.keys import flatten, with_keys, with_values
from loco_mjx.config.learning import DistillConfig, NetworkConfig, PPOConfig
from loco_mjx.config.methods import teacher_of, with_method
from loco_mjx.config.presets import PRESETS, preset, with_robot
from loco_mjx.config.tree import (
    ActionConfig,
    Config,
    DepthConfig,
    EnvConfig,
    ObservationConfig,
    PhysicsConfig,
    RandomizationConfig,
    RewardConfig,
    TerminationConfig,
)
from loco_mjx.config.written import from_dict, to_dict

__all__ = [
    "PRESETS",
    "ActionConfig",
    "Config",
    "DepthConfig",
    "DistillConfig",
    "EnvConfig",
    "NetworkConfig",
    "ObservationConfig",
    "PPOConfig",
    "PhysicsConfig",
    "RandomizationConfig",
    "RewardConfig",
    "TerminationConfig",
    "check",
    "flatten",
    "from_dict",
    "preset",
    "teacher_of",
    "to_dict",
    "with_controller",
    "with_keys",
    "with_method",
    "with_robot",
    "with_values",
]
