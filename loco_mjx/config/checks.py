"""Whether the values of a configuration fit together; each one's own range is declared beside it in the tree."""

from __future__ import annotations

import dataclasses

from loco_mjx import ranges
from loco_mjx.config.learning import NetworkConfig
from loco_mjx.config.methods import teacher_of
from loco_mjx.config.tree import Config, EnvConfig
from loco_mjx.controllers import get_controller
from loco_mjx.errors import UserError
from loco_mjx.robots import get_robot

MOST_SAMPLES = 2**31 - 1  # a training state counts them in 32 bits


def check(config: Config, num_devices: int = 1) -> None:
    """Checks every value's range, and that sizes fit together.

    Raises:
        UserError: naming the value and what is accepted, or the sizes that do not divide, and what would.
    """
    ranges.check(config)
    get_robot(config.env.robot)
    _check_observation(config.env)
    ppo = config.ppo
    if ppo.num_envs % num_devices:
        raise UserError(f"ppo.num_envs {ppo.num_envs} does not divide over {num_devices} devices; accepted: a multiple")
    if ppo.minibatch % num_devices:
        raise UserError(
            f"ppo.minibatch {ppo.minibatch} does not divide over {num_devices} devices; accepted: a multiple"
        )
    if ppo.samples_per_iteration % ppo.minibatch:
        raise UserError(
            f"ppo.minibatch {ppo.minibatch} does not divide the {ppo.samples_per_iteration} samples of an iteration "
            f"(num_envs {ppo.num_envs} × unroll {ppo.unroll}); accepted: a divisor of it"
        )
    if ppo.iterations * ppo.samples_per_iteration > MOST_SAMPLES:
        raise UserError(
            f"ppo.total_steps {ppo.total_steps} in iterations of {ppo.samples_per_iteration} samples are "
            f"{ppo.iterations * ppo.samples_per_iteration}; accepted: {MOST_SAMPLES} or less"
        )
    _check_order(config)
    _check_latency(config.env)
    _check_narrowing("ppo.final_std", ppo.final_std, config.network.initial_std)
    if config.method == "distill":
        _check_distill(config, num_devices)


def _check_observation(env: EnvConfig) -> None:
    """Checks that there is a state, of what the controller's policies can know."""
    if not env.observation.state_size:
        raise UserError("env.observation has no sensor; accepted: one of them True at least")
    if env.observation.last_action and get_controller(env.controller).scale is not None:
        raise UserError(
            f"env.observation.last_action is True, joint targets, which controller '{env.controller}' has none of; "
            "accepted: False"
        )


def _check_latency(env: EnvConfig) -> None:
    """Checks that what is measured late is not older than a history can hold."""
    step, latency = 1 / get_controller(env.controller).rate(get_robot(env.robot)), env.randomization.latency
    if env.randomization.enabled and latency[1] > step:
        raise UserError(
            f"env.randomization.latency is {latency}, more than a control step of this robot; accepted: up to {step:g}"
        )


def _check_distill(config: Config, num_devices: int) -> None:
    """Checks the values of method `distill`."""
    distill, samples = config.distill, config.ppo.samples_per_iteration
    teacher = teacher_of(config).ppo
    if teacher.iterations * teacher.samples_per_iteration > MOST_SAMPLES:
        raise UserError(
            f"distill.teacher_ratio {distill.teacher_ratio} of ppo.total_steps {config.ppo.total_steps} are "
            f"{teacher.total_steps} samples; accepted: {MOST_SAMPLES} or less"
        )
    if config.ppo.final_std is not None:
        raise UserError(
            f"ppo.final_std is {config.ppo.final_std}, but while a policy imitates it explores by distill.std; "
            "accepted: None, and distill.teacher_std for its teacher"
        )
    _check_narrowing("distill.teacher_std", distill.teacher_std, NetworkConfig.initial_std)
    if samples % distill.minibatch or distill.minibatch % num_devices:
        raise UserError(
            f"distill.minibatch {distill.minibatch} does not divide the {samples} samples of an iteration, or not over "
            f"{num_devices} devices; accepted: a divisor of the one and a multiple of the other"
        )


def _check_narrowing(name: str, final: float | None, initial: float) -> None:
    """Checks that exploration does not end wider than it begins."""
    if final is not None and final > initial:
        raise UserError(f"{name} {final} is wider than {initial}, where exploration begins; accepted: that or less")


def _check_order(config: Config) -> None:
    """Checks that the lower of two values is the lower one."""
    for name, value in dataclasses.asdict(config.env.randomization).items():
        if isinstance(value, tuple) and value[0] > value[1]:
            raise UserError(f"env.randomization.{name} is {value}; accepted: two values, the lower first")
    depth = config.env.observation.depth
    if depth.near >= depth.far:
        raise UserError(f"env.observation.depth: near {depth.near}, far {depth.far}; accepted: near < far")
    if depth.blind_min > depth.blind_max:
        raise UserError(
            f"env.observation.depth: blind_min {depth.blind_min}, blind_max {depth.blind_max} are not in order"
        )
