"""`loco-mjx train`: trains a policy on a task; the same command again goes on where it stopped."""

from __future__ import annotations

import dataclasses
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from loco_mjx import config as config_lib
from loco_mjx import controllers
from loco_mjx.cli import words
from loco_mjx.cli.parse import parse
from loco_mjx.config import Config, DistillConfig, EnvConfig, NetworkConfig, PPOConfig
from loco_mjx.config.quantities import NumEnvs, TotalSteps
from loco_mjx.errors import UserError
from loco_mjx.ranges import SEED, Range
from loco_mjx.robots import DEFAULT, get_robot
from loco_mjx.run import settings
from loco_mjx.run.progress import duration
from loco_mjx.run.run_log import Run
from loco_mjx.run.schedule import LoopOptions

PROG = "loco-mjx train"
PRESET = "fast"
CPU_MINUTES = 20
KEYS = ("env", "network", "ppo", "distill")  # of the configuration; every key in them is an option
SHORT_FORMS = {
    "task": "env.task",
    "robot": "env.robot",
    "controller": "env.controller",
    "num_envs": "ppo.num_envs",
    "total_steps": "ppo.total_steps",
}


@dataclass(frozen=True)
class Options:
    """Trains a policy on a task. The same command again resumes; Ctrl-C saves and stops.

    Every key of the configuration is an option, e.g. `--ppo.learning-rate 1e-4 --env.randomization.enabled True`.
    """

    task: str | None = None
    """Task to train on, one of those above; None: thin."""
    robot: str | None = None
    """Robot to train, one of those above or the path of its MJCF (docs/robots.md); None: a1."""
    controller: Literal["pd", "mpc"] | None = None
    """Between policy and motors; None: pd."""
    policy: str = "loco-transformer"
    """Policy to train, one of those above; it decides whether depth is rendered."""
    method: Literal["ppo", "distill"] = "ppo"
    """How it learns: by PPO alone, as in the paper, or from a privileged teacher first (`distill`)."""
    seed: SEED = 0
    """Seed of everything random."""
    seeds: str | None = None
    """Several seeds in one program instead, as in 0-4 or 0,2,5; each one's run is seedSEED in --out."""
    preset: str = PRESET
    """Defaults of the whole configuration, one of those above: the paper's, for wall-clock, or for the robot."""
    total_steps: TotalSteps | None = None
    """Samples to train; None: the preset's on a GPU, on a CPU what takes about 20 minutes."""
    num_envs: NumEnvs | None = None
    """Parallel environments; None: the preset's."""
    eval_tasks: str | None = None
    """Tasks to evaluate on besides its own as it learns, e.g. wide,moving."""
    out: Path | None = None
    """Directory of the run; None: runs/[ROBOT/][mpc/]TASK/POLICY/seedSEED. With --seeds its parent."""
    coordinator: str | None = None
    """HOST:PORT of process 0, for a run over several; under `srun` with several tasks SLURM says it."""
    process_id: Annotated[int, Range(0, 2**16)] | None = None
    """Which of them this one is: 0 to num-processes - 1."""
    num_processes: Annotated[int, Range(1, 2**16)] | None = None
    """How many processes train together; --num-envs is of all of them."""
    loop: Annotated[LoopOptions, tyro.conf.arg(name="")] = field(default_factory=LoopOptions)
    env: tyro.conf.FlagConversionOff[EnvConfig] = field(default_factory=EnvConfig)
    network: tyro.conf.FlagConversionOff[NetworkConfig] = field(default_factory=NetworkConfig)
    ppo: tyro.conf.FlagConversionOff[PPOConfig] = field(default_factory=PPOConfig)
    distill: tyro.conf.FlagConversionOff[DistillConfig] = field(default_factory=DistillConfig)


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if what is asked cannot be done; nothing is written then.
    """
    options = read(args)
    from loco_mjx.run import multihost

    where = multihost.place(options.coordinator, options.process_id, options.num_processes, os.environ)
    with multihost.joined(where):
        return _train(options, args, 1 if where is None else where.count)


def _train(options: Options, args: Sequence[str], processes: int) -> int:
    """Runs the command on one of several processes, or the only one."""
    config = configuration(options)
    settings.check(config)
    eval_tasks = other_tasks(options)
    runs = planned(options, args, config)

    from loco_mjx.evaluation.in_training import evaluators
    from loco_mjx.run import collectives, directory, machine, start
    from loco_mjx.run.progress import Output

    found = [directory.find(run.directory) for run in runs]
    machine.set_up(machine.shards(*settings.divided(config), processes=processes))
    console = Output()
    if not gave_total(options, args):
        totals = [run.ppo.total_steps for run in found if run is not None]
        total = int(collectives.broadcast(str(max(totals) if totals else default_total(config, len(runs)))))
        runs = [dataclasses.replace(run, config=settings.with_total(run.config, total)) for run in runs]
    for run, there in zip(runs, found, strict=True):
        if there is not None:
            directory.reconcile(run.directory, there, run.config)
    path, curves = runs[0].directory, runs[0].directory / "metrics.csv"
    if options.seeds is not None:
        path, curves = path.parent, path.parent / "seed*" / "metrics.csv"
    if all(
        there is not None and start.finished(run.directory, run.config) for run, there in zip(runs, found, strict=True)
    ):
        console.print(f"{path} is finished; next: loco-mjx evaluate {path}", soft_wrap=True)
        return 0
    console.print(f"preset {options.preset}, in {path}", soft_wrap=True)
    evaluate = evaluators(options.loop, eval_tasks)
    outcome = start.train(runs, options.loop, console, [*PROG.split(), *args], evaluate)
    if outcome.signal is None:
        print(f"finished: {outcome.samples:,} samples, curves in {curves}; next: loco-mjx evaluate {path}")
        return 0
    return interrupted(outcome.samples, outcome.signal, args)


def other_tasks(options: Options) -> list[str]:
    """The tasks that are evaluated on besides the run's own.

    Raises:
        UserError: if one of them is unknown, or the list is none.
    """
    from loco_mjx.cli.comma_lists import parse_names
    from loco_mjx.scene.tasks import get_task

    if options.eval_tasks is None:
        return []
    return [get_task(name).name for name in parse_names(options.eval_tasks, "task")]


def planned(options: Options, args: Sequence[str], config: Config) -> list[Run]:
    """The run of a single seed, or those of several, and where they lie.

    Raises:
        UserError: if the seeds mean nothing, or are given in two ways.
    """
    from loco_mjx.cli.comma_lists import parse_seeds

    home = Path("runs", *_folders(config.env), config.env.task, config.policy)
    if options.seeds is None:
        return [Run(config, options.out or home / f"seed{config.seed}")]
    if any(name == "--seed" for name, _ in words.given(args)):
        raise UserError("--seed and --seeds are given; accepted: --seed for one run, --seeds for several together")
    if config.method == "distill":
        raise UserError("--seeds trains by PPO alone; accepted with --method distill: one --seed after the other")
    seeds, home = parse_seeds(options.seeds), options.out or home
    if len(seeds) < sum(len(parse_seeds(part)) for part in options.seeds.split(",")):
        raise UserError(f"seeds '{options.seeds}' name one twice; accepted: each once, e.g. 0-4 or 0,2,5")
    if (home / "config.json").exists():
        raise UserError(f"{home} holds a single run; --seeds makes a directory of runs: choose another --out")
    return [Run(dataclasses.replace(config, seed=seed), home / f"seed{seed}") for seed in seeds]


def _folders(env: EnvConfig) -> list[str]:
    """What of a run's path tells a robot and a controller from the default ones."""
    robot = [] if env.robot == DEFAULT else [get_robot(env.robot).name]
    return robot + ([] if env.controller == controllers.DEFAULT else [env.controller])


def read(args: Sequence[str]) -> Options:
    """Options from the command line, on top of the preset's values.

    Raises:
        UserError: on anything that is not accepted.
    """
    default = Options()
    named = {name: values[0] for name, values in words.given(args) if values}
    default = dataclasses.replace(default, preset=named.get("--preset", default.preset))
    robot = named.get("--robot", named.get("--env.robot", DEFAULT))
    controller = named.get("--controller", named.get("--env.controller", controllers.DEFAULT))
    base = config_lib.preset(default.preset, robot, controller)
    given = {group: getattr(base, group) for group in KEYS}
    default = dataclasses.replace(default, **given)
    options = parse(Options, args, PROG, default, names=("tasks", "robots", "policies", "presets"), keys=KEYS)
    _check_short_forms(options, args)
    return options


def _check_short_forms(options: Options, args: Sequence[str]) -> None:
    """Refuses an option and the configuration's key behind it with different values: one would silently win."""
    named = {name for name, _ in words.given(args)}
    for short, key in SHORT_FORMS.items():
        group, _, name = key.partition(".")
        mine, its = getattr(options, short), getattr(getattr(options, group), name)
        given = tuple(f"--{option.replace('_', '-')}" for option in (short, key))
        if named.issuperset(given) and mine is not None and mine != its:
            raise UserError(f"{given[0]} is {mine} and {given[1]} is {its}, which mean the same; accepted: one of them")


def configuration(options: Options) -> Config:
    """The run's configuration; the default number of samples is not decided here.

    Raises:
        UnknownNameError: if there is no policy of that name.
    """
    given = ("policy", "method", "seed", "env", "network", "ppo", "distill")
    config = Config(**{name: getattr(options, name) for name in given})
    if options.task is not None:
        config = settings.with_task(config, options.task)
    if options.num_envs is not None:
        config = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, num_envs=options.num_envs))
    config = settings.complete(config)
    return config if options.total_steps is None else settings.with_total(config, options.total_steps)


def gave_total(options: Options, args: Sequence[str]) -> bool:
    """Whether the command line says how many samples to train."""
    return options.total_steps is not None or any(name == "--ppo.total-steps" for name, _ in words.given(args))


def default_total(config: Config, seeds: int = 1) -> int:
    """The preset's samples on an accelerator; on a CPU what takes all seeds about 20 minutes, which it says."""
    from loco_mjx.run import machine

    full = config.ppo.total_steps
    if not machine.on_cpu():
        return full
    seconds = 1 / settings.cpu_rate(config)  # for a sample
    if config.method == "distill":
        seconds += config.distill.teacher_ratio / settings.cpu_teacher_rate(config)
    rate = 1 / seconds / seeds
    budget = min(full, max(round(rate * 60 * CPU_MINUTES, -5), 100_000))
    each = "" if seeds == 1 else " of each seed"
    print(
        f"on this CPU: {budget:,.0f} samples{each}, about {CPU_MINUTES} min, for a first learning curve; "
        f"all {full:,} would take about {duration(full / rate)}: --total-steps {full}"
    )
    return int(budget)


def interrupted(samples: int, stopped_by: int, args: Sequence[str]) -> int:
    """Says how to go on after a signal; the exit code."""
    program = sys.argv[0] if os.path.basename(sys.argv[0]) == "loco-mjx" else "loco-mjx"
    done = f"saved at {samples:,} samples" if samples else "nothing was to be saved yet"
    text = f"{done}; to go on: {shlex.join([program, 'train', *args])}"
    try:
        print(text, flush=True)
    except OSError:  # whoever read that has gone
        print(f"loco-mjx: {text}", file=sys.stderr)
    return 128 + stopped_by
