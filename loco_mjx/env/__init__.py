"""The environment: reward, observation, randomisation, metrics, autoreset."""

from __future__ import annotations

import dataclasses
from typing import Any

from loco_mjx.config import Config, EnvConfig, check, with_controller, with_robot
from loco_mjx.env.loco_env import LocoEnv


def make_env(task: str = "thin", config: EnvConfig | None = None, **overrides: Any) -> LocoEnv:
    """Makes the environment of a task.

    Args:
        task: a name of the task registry, e.g. "thin", "mountain".
        config: the environment's configuration; its `task` is replaced by `task`. None: the paper's.
        **overrides: fields of :class:`loco_mjx.config.EnvConfig`, e.g. ``horizon=500``.

    With another `robot` or `controller` comes what belongs to it, as in a run: gains, and what is observed.

    Raises:
        UnknownNameError: if the task is unknown.
        UserError: if a value is not accepted.
        TypeError: if an override is not a field of EnvConfig.
    """
    whole = Config(env=config or EnvConfig())
    whole = with_robot(whole, overrides.get("robot", whole.env.robot))
    whole = with_controller(whole, overrides.get("controller", whole.env.controller))
    whole = dataclasses.replace(whole, env=dataclasses.replace(whole.env, task=task, **overrides))
    check(whole)
    return LocoEnv(whole.env)


__all__ = ["LocoEnv", "make_env"]
