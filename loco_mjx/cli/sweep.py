"""`loco-mjx sweep`: trains and evaluates every combination of tasks, policies and seeds; again: goes on."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from loco_mjx import imports
from loco_mjx.cli import words as command_line
from loco_mjx.cli.parse import parse
from loco_mjx.config.quantities import NumEnvs, TotalSteps
from loco_mjx.errors import UserError
from loco_mjx.ranges import COUNT, Range

if TYPE_CHECKING:
    from loco_mjx.compare.cells import Plan
    from loco_mjx.compare.launch import Launcher

PROG = "loco-mjx sweep"
FAILED = 1


@dataclass(frozen=True)
class Options:
    """Trains and evaluates every combination of tasks, policies and seeds. The same command again goes on.

    What is finished is skipped; what fails is listed at the end, and the exit code is then 1.
    """

    tasks: str = "thin"
    """Tasks to train on, joined by commas."""
    policies: str = "loco-transformer"
    """Policies to train, joined by commas; +KEY=VALUE changes one: loco-transformer+layers=1."""
    seeds: str = "0"
    """Seeds, as in 0-4 or 0,2,5."""
    out: Path = Path("runs/sweep")
    """Directory of the sweep; a run's is TASK/POLICY/seedSEED in it."""
    eval_tasks: str | None = None
    """Tasks to evaluate each run on at its end, joined by commas; None: the one it was trained on."""
    episodes: COUNT = 32
    """Episodes of each evaluation."""
    preset: str = "fast"
    """Defaults of the whole configuration, as in train."""
    total_steps: TotalSteps | None = None
    """Samples of each run; None: the preset's, on a CPU too."""
    num_envs: NumEnvs | None = None
    """Parallel environments; None: the preset's."""
    changes: Annotated[tuple[str, ...], tyro.conf.arg(name="set")] = ()
    """Keys of every run's configuration: --set ppo.clip=0.1 env.randomization.enabled=True."""
    launcher: Literal["local", "ray"] = "local"
    """Where runs go: local is this machine, one after the other, each on all devices; ray is a Ray cluster."""
    ray_address: str | None = None
    """Of --launcher ray, HOST:PORT; None: $RAY_ADDRESS, else this machine's cluster, else one started for the sweep."""
    cpus_per_cell: Annotated[int, Range(1, 10_000)] | None = None
    """Of --launcher ray, set aside for each run; None: 1 where there are GPUs, else all of the largest node."""
    gpus_per_cell: Annotated[float, Range(0, 1000)] | None = None
    """Of --launcher ray, set aside for each run; None: 1 where there are any."""
    dry_run: bool = False
    """Only show what would run, and how long."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if what is asked cannot be done; nothing is written then.
    """
    options = parse(Options, args, PROG, names=("tasks", "policies", "presets"))
    from rich.console import Console

    from loco_mjx.cli.comma_lists import parse_names, parse_seeds
    from loco_mjx.compare import launch
    from loco_mjx.run.variant import parse_variant

    tasks, seeds = parse_names(options.tasks, "tasks"), parse_seeds(options.seeds)
    variants = [parse_variant(text) for text in parse_names(options.policies, "policies")]
    if options.out.exists() and not options.out.is_dir():
        raise UserError(f"{options.out} is a file; choose a directory for the sweep")
    modules = tuple(map(imports.absolute, command_line.imports(args)))
    cells = dataclasses.replace(plan(options), imports=modules).cells(tasks, variants, seeds)
    result = launch.sweep(cells, Console(), launcher(options), options.dry_run)
    if not options.dry_run and (result.ran or result.skipped):
        print(f"next: loco-mjx table {options.out}; loco-mjx curves {options.out}")
    return FAILED if result.failed else 0


def launcher(options: Options) -> Launcher:
    """Where the cells run.

    Raises:
        UserError: if Ray is asked for and missing, or its options are given to another launcher.
    """
    if options.launcher == "ray":
        from loco_mjx.compare.ray_launcher import OnRay

        return OnRay(options.ray_address, options.cpus_per_cell, options.gpus_per_cell)
    from loco_mjx.compare.launch import Local

    stray = [name for name in ("ray_address", "cpus_per_cell", "gpus_per_cell") if getattr(options, name) is not None]
    if stray:
        raise UserError(f"--{stray[0].replace('_', '-')} is of --launcher ray; this is --launcher {options.launcher}")
    return Local()


def plan(options: Options) -> Plan:
    """What every cell shares.

    Raises:
        UserError: if a key is unknown.
    """
    from loco_mjx.cli.comma_lists import parse_names
    from loco_mjx.compare.cells import Plan
    from loco_mjx.run.variant import parse_change

    changes = [parse_change(text) for text in options.changes]
    changes += [] if options.num_envs is None else [("ppo.num_envs", str(options.num_envs))]
    eval_tasks = tuple(parse_names(options.eval_tasks, "tasks")) if options.eval_tasks is not None else ()
    return Plan(options.out, options.preset, options.total_steps, eval_tasks, options.episodes, tuple(changes))
