"""`loco-mjx train`: trains a policy on a task; the same command again goes on where it stopped."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from loco_mjx import config as config_lib
from loco_mjx.cli.parse import check_seed, parse
from loco_mjx.config import Config, EnvConfig, NetworkConfig, PPOConfig
from loco_mjx.run.loop import LoopOptions
from loco_mjx.run.progress import duration

PROG = "loco-mjx train"
PRESET = "fast"
# Samples per second and core on a CPU, with and without depth, as measured on two cores; for the default budget only.
CPU_RATE = {True: 400.0, False: 4000.0}
CPU_MINUTES = 20


@dataclass(frozen=True)
class Options:
    """Trains a policy on a task. The same command again resumes; Ctrl-C saves and stops.

    Every key of the configuration is an option, e.g. `--ppo.learning-rate 1e-4 --env.randomization.enabled True`.
    """

    task: str | None = None
    """Task to train on; None: thin."""
    policy: str = "loco-transformer"
    """Policy to train; it decides whether depth is rendered."""
    seed: int = 0
    """Seed of everything random."""
    preset: str = PRESET
    """Defaults of the whole configuration: the paper's, or ones tuned for wall-clock."""
    total_steps: int | None = None
    """Samples to train; None: the preset's on a GPU, on a CPU what takes about 20 minutes."""
    num_envs: int | None = None
    """Parallel environments; None: the preset's."""
    out: Path | None = None
    """Directory of the run; None: runs/TASK/POLICY/seedSEED."""
    loop: Annotated[LoopOptions, tyro.conf.arg(name="")] = field(default_factory=LoopOptions)
    env: tyro.conf.FlagConversionOff[EnvConfig] = field(default_factory=EnvConfig)
    network: tyro.conf.FlagConversionOff[NetworkConfig] = field(default_factory=NetworkConfig)
    ppo: tyro.conf.FlagConversionOff[PPOConfig] = field(default_factory=PPOConfig)


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if what is asked cannot be done; nothing is written then.
    """
    options = read(args)
    config = configuration(options)
    path = options.out or Path("runs", config.env.task, config.policy, f"seed{config.seed}")
    check(config)

    from rich.console import Console

    from loco_mjx.run import directory, machine, start

    found = directory.find(path)
    machine.set_up(machine.shards(config.ppo.num_envs, config.ppo.minibatch))
    console = Console()
    if not gave_total(options, args):
        config = with_total(config, found.ppo.total_steps if found else default_total(config))
    if found is not None:
        directory.reconcile(path, found, config)
        if start.finished(path, config):
            console.print(f"{path} is finished; next: loco-mjx evaluate {path}", soft_wrap=True)
            return 0
    console.print(f"preset {options.preset}, in {path}", soft_wrap=True)
    outcome = start.train(config, path, options.loop, console, [*PROG.split(), *args])
    return conclude(outcome.samples, outcome.signal, path, args)


def read(args: Sequence[str]) -> Options:
    """Options from the command line, on top of the preset's values.

    Raises:
        UserError: on anything that is not accepted.
    """
    default = Options()
    words = [word for arg in args for word in arg.split("=", 1)]
    if "--preset" in words[:-1]:
        default = dataclasses.replace(default, preset=words[words.index("--preset") + 1])
    base = config_lib.preset(default.preset)
    default = dataclasses.replace(default, env=base.env, network=base.network, ppo=base.ppo)
    return parse(Options, args, PROG, default)


def configuration(options: Options) -> Config:
    """The run's configuration, but for a default number of samples.

    Raises:
        UnknownNameError: if there is no policy of that name.
    """
    from loco_mjx.errors import UnknownNameError
    from loco_mjx.networks.policies import POLICIES

    if options.policy not in POLICIES:
        raise UnknownNameError("policy", options.policy, POLICIES)
    env = dataclasses.replace(options.env, task=options.task or options.env.task)
    if not POLICIES[options.policy].uses_depth:  # nothing would look at it
        depth = dataclasses.replace(env.observation.depth, enabled=False)
        env = dataclasses.replace(env, observation=dataclasses.replace(env.observation, depth=depth))
    ppo = options.ppo
    if options.num_envs is not None:
        ppo = dataclasses.replace(ppo, num_envs=options.num_envs)
    config = Config(policy=options.policy, seed=options.seed, env=env, network=options.network, ppo=ppo)
    return config if options.total_steps is None else with_total(config, options.total_steps)


def check(config: Config) -> None:
    """Checks names and sizes.

    Raises:
        UserError: naming what does not fit.
    """
    from loco_mjx.scene.tasks import get_task

    get_task(config.env.task)
    check_seed(config.seed)
    config_lib.check(config)


def with_total(config: Config, total: int) -> Config:
    """The configuration with another number of samples."""
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, total_steps=total))


def gave_total(options: Options, args: Sequence[str]) -> bool:
    """Whether the command line says how many samples to train."""
    key = "--ppo.total-steps"
    return options.total_steps is not None or any(arg.replace("_", "-").split("=")[0] == key for arg in args)


def default_total(config: Config) -> int:
    """The preset's samples on an accelerator; on a CPU what takes about 20 minutes, which it says."""
    from loco_mjx.run import machine

    full = config.ppo.total_steps
    if not machine.on_cpu():
        return full
    rate = CPU_RATE[config.env.observation.depth.enabled] * machine.cores()
    budget = min(full, round(rate * 60 * CPU_MINUTES, -5))
    print(
        f"on this CPU: {budget:,.0f} samples, about {CPU_MINUTES} min, for a first learning curve; "
        f"all {full:,} would take about {duration(full / rate)}: --total-steps {full}"
    )
    return int(budget)


def conclude(samples: int, stopped_by: int | None, path: Path, args: Sequence[str]) -> int:
    """Says how the run ended and how to go on; the exit code."""
    if stopped_by is None:
        print(f"finished: {samples:,} samples, curves in {path}/metrics.csv; next: loco-mjx evaluate {path}")
        return 0
    program = sys.argv[0] if os.path.basename(sys.argv[0]) == "loco-mjx" else "loco-mjx"
    print(f"saved at {samples:,} samples; to go on: {shlex.join([program, 'train', *args])}")
    return 128 + stopped_by
