"""Which of the user's modules a configuration needs: noted when a run starts, said when one is missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from loco_mjx.config import Config
from loco_mjx.config.reward_terms import REWARDS
from loco_mjx.errors import UserError
from loco_mjx.networks.registry import POLICIES
from loco_mjx.registry import INTERACTIVE, Registry
from loco_mjx.robots import ROBOTS, is_path
from loco_mjx.scene.tasks import TASKS


def with_imports(config: Config) -> Config:
    """The configuration with the modules that brought its task, its robot, its policy and its reward's terms."""
    origins = [registry.origin(name) for registry, name in _names(config)]
    own = [word for word in dict.fromkeys(origins) if word is not None and word != INTERACTIVE]
    return dataclasses.replace(config, imports=tuple(own))


def check(config: Config, where: object) -> None:
    """Refuses a configuration whose names nobody has registered.

    Args:
        config: of a run or an exported policy.
        where: what it was read from.

    Raises:
        UserError: naming the first one that is missing, and the modules that bring it where they were noted.
    """
    for registry, name in _names(config):
        if name in registry:
            continue
        if not config.imports:
            registry.find(name)  # says what is accepted
        modules = " ".join(f"--import {word}" for word in config.imports)
        raise UserError(f"{where} needs the {registry.kind} '{name}', which is not there; pass {modules}")


def _names(config: Config) -> Iterator[tuple[Registry[Any], str]]:
    """Each name in a configuration, and where it is looked up."""
    yield TASKS, config.env.task
    yield POLICIES, config.policy
    if not is_path(config.env.robot):
        yield ROBOTS, config.env.robot
    for name, weight in config.env.reward.terms.items():
        if weight:
            yield REWARDS, name
