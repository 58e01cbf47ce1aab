"""What a run is to be: a configuration completed by what its policy and its method need, and checked."""

from __future__ import annotations

import dataclasses

from loco_mjx import config as config_lib
from loco_mjx.config import Config
from loco_mjx.errors import UnknownNameError
from loco_mjx.run import machine

# Samples per second and core on a CPU, by controller, with and without depth, as measured on two cores; for estimates.
CPU_RATE = {"pd": {True: 400.0, False: 4000.0}, "mpc": {True: 150.0, False: 300.0}}
CPU_TEACHER_RATE = {"pd": 4000.0, "mpc": 300.0}  # the same of method `distill`'s teacher


def complete(config: Config) -> Config:
    """A configuration with what its policy and its method need; depth that no policy looks at is off.

    Raises:
        UnknownNameError: if there is no policy of that name.
    """
    from loco_mjx.networks.registry import POLICIES

    if config.policy not in POLICIES:
        raise UnknownNameError("policy", config.policy, POLICIES)
    policy, observation = POLICIES[config.policy], config.env.observation
    if not policy.uses_depth:
        observation = dataclasses.replace(observation, depth=dataclasses.replace(observation.depth, enabled=False))
    if policy.uses_privileged:
        observation = dataclasses.replace(observation, privileged=True)
    config = dataclasses.replace(config, env=dataclasses.replace(config.env, observation=observation))
    return config_lib.with_method(config)


def check(config: Config) -> None:
    """Checks names and sizes.

    Raises:
        UserError: naming what does not fit.
    """
    from loco_mjx.scene.tasks import get_task

    get_task(config.env.task)
    config_lib.check(config)


def divided(config: Config) -> tuple[int, ...]:
    """The sizes that training divides over the devices."""
    imitated = (config.distill.minibatch,) if config.method == "distill" else ()
    return config.ppo.num_envs, config.ppo.minibatch, *imitated


def with_total(config: Config, total: int) -> Config:
    """The configuration with another number of samples."""
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, total_steps=total))


def with_task(config: Config, task: str) -> Config:
    """The configuration on another task."""
    return dataclasses.replace(config, env=dataclasses.replace(config.env, task=task))


def total_samples(config: Config) -> int:
    """Samples that a run trains on: whole iterations."""
    return config.ppo.iterations * config.ppo.samples_per_iteration


def cpu_rate(config: Config) -> float:
    """Samples per second of training on all cores of this machine, without its teacher."""
    return CPU_RATE[config.env.controller][config.env.observation.depth.enabled] * machine.cores()


def cpu_teacher_rate(config: Config) -> float:
    """Samples per second of training its teacher on all cores of this machine."""
    return CPU_TEACHER_RATE[config.env.controller] * machine.cores()
