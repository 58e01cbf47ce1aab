"""The environment: reward, observation, randomisation, metrics, autoreset."""

from __future__ import annotations

import dataclasses
from typing import Any

from loco_mjx.config import EnvConfig
from loco_mjx.env.loco_env import LocoEnv


def make_env(task: str = "thin", config: EnvConfig | None = None, **overrides: Any) -> LocoEnv:
    """Makes the environment of a task.

    Args:
        task: a name of the task registry, e.g. "thin", "mountain".
        config: the environment's configuration; its `task` is replaced by `task`. None: the paper's.
        **overrides: fields of :class:`loco_mjx.config.EnvConfig`, e.g. ``horizon=500``.

    Raises:
        UnknownNameError: if the task is unknown.
        TypeError: if an override is not a field of EnvConfig.
    """
    return LocoEnv(dataclasses.replace(config or EnvConfig(), task=task, **overrides))


__all__ = ["LocoEnv", "make_env"]
