"""loco-mjx: vision-guided legged locomotion, from scene to policy in one JAX program."""

from __future__ import annotations

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:
    from loco_mjx.api import Film, Policy, configure, evaluate, film, load_policy, train
    from loco_mjx.config import Config, EnvConfig, preset
    from loco_mjx.env import LocoEnv, make_env
    from loco_mjx.env.brax import wrap_for_brax
    from loco_mjx.env.reward import register_reward
    from loco_mjx.env.state import State
    from loco_mjx.networks.registry import register_policy
    from loco_mjx.robots import register_robot
    from loco_mjx.run.machine import set_up
    from loco_mjx.scene.tasks import register_task

__version__ = "0.1.0"
__all__ = [
    "Config",
    "EnvConfig",
    "Film",
    "LocoEnv",
    "Policy",
    "State",
    "__version__",
    "configure",
    "evaluate",
    "film",
    "load_policy",
    "make_env",
    "preset",
    "register_policy",
    "register_reward",
    "register_robot",
    "register_task",
    "set_up",
    "train",
    "wrap_for_brax",
]

# JAX and MuJoCo load when a name is first asked for, not when the package's version is.
_HOMES = {
    "Config": "loco_mjx.config",
    "EnvConfig": "loco_mjx.config",
    "Film": "loco_mjx.api",
    "LocoEnv": "loco_mjx.env",
    "Policy": "loco_mjx.api",
    "State": "loco_mjx.env.state",
    "configure": "loco_mjx.api",
    "evaluate": "loco_mjx.api",
    "film": "loco_mjx.api",
    "load_policy": "loco_mjx.api",
    "make_env": "loco_mjx.env",
    "preset": "loco_mjx.config",
    "register_policy": "loco_mjx.networks.registry",
    "register_reward": "loco_mjx.env.reward",
    "register_robot": "loco_mjx.robots",
    "register_task": "loco_mjx.scene.tasks",
    "set_up": "loco_mjx.run.machine",
    "train": "loco_mjx.api",
    "wrap_for_brax": "loco_mjx.env.brax",
}


def __getattr__(name: str) -> _typing.Any:
    if name in _HOMES:
        return getattr(_importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'loco_mjx' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
