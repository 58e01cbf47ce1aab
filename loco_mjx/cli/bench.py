"""`loco-mjx bench`: measures the speed of one part of the program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from loco_mjx.cli import words
from loco_mjx.cli.output import Show, one_object
from loco_mjx.cli.parse import parse
from loco_mjx.config.quantities import NumEnvs, TotalSteps
from loco_mjx.errors import UserError
from loco_mjx.ranges import SEED, Range
from loco_mjx.robots import DEFAULT

PROG = "loco-mjx bench"
NUM_ENVS = {"pd": 256, "mpc": 128}  # by controller
SCENES = ("depth", "physics", "env", "train")
# The parts that look at an option; the others would ignore it. `learn` compares with the paper's A1.
READ = {
    "--task": (*SCENES, "learn"),
    "--robot": (*SCENES, "mpc"),
    "--controller": ("env", "train"),
    "--policy": ("env", "train", "learn"),
    "--seconds": (*SCENES, "mpc"),
    "--seeds": ("train",),
    "--method": ("learn",),
    "--seed": ("learn",),
    "--total-steps": ("learn",),
    "--out": ("learn",),
}
EVALUATED = ("--evaluations", "12", "--evaluation-episodes", "64")  # of `learn`: often, and in many scenes


@dataclass(frozen=True)
class Options:
    """Measures frames, physics steps, control steps or samples per second; or how long learning takes.

    Depth and physics are measured beside their peer: C MuJoCo on the same scenes with as many threads; `mpc`, the
    whole-body controller, beside libraries that solve the same quadratic programs on one core. `learn` trains a policy
    as `loco-mjx train` does, and says after how many samples and minutes it was at the paper's distance.
    """

    part: tyro.conf.Positional[Literal["depth", "physics", "mpc", "env", "train", "learn"]]
    """What to measure."""
    task: str = "thin"
    """In which task's scenes."""
    robot: str = DEFAULT
    """Of which robot, by name or the path of its MJCF."""
    policy: str = "loco-transformer"
    """For train, learn, and env, where it decides whether depth is rendered."""
    controller: Literal["pd", "mpc"] = "pd"
    """For env and train: what the policy commands."""
    num_envs: NumEnvs | None = None
    """Environments side by side; None: 256, of --controller mpc 128."""
    seeds: Annotated[int, Range(1, 1000)] | None = None
    """For train: so many seeds in one program, beside one seed alone."""
    seconds: Annotated[float, Range(0, 3600, above=True)] = 5.0
    """To measure for, at least, beside the compilation."""
    method: Literal["ppo", "distill"] = "distill"
    """For learn: how."""
    seed: SEED = 0
    """For learn: of everything random."""
    total_steps: TotalSteps | None = None
    """For learn: samples to train; None: those of `loco-mjx train`."""
    out: Path | None = None
    """For learn: directory of the run; None: runs/learn/TASK/POLICY/METHOD-seedSEED. The same again resumes it."""
    json: bool = False
    """Print one JSON object and nothing else."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if a name is unknown or sizes do not divide.
    """
    options = parse(Options, args, PROG, names=("tasks", "robots", "policies"))
    check(options, args)
    with one_object(options.json) as show:
        if options.part == "learn":
            return learn(options, show)
        from loco_mjx.config import preset
        from loco_mjx.run import machine, provenance
        from loco_mjx.scene.tasks import get_task

        get_task(options.task)
        sizes = [options.num_envs or NUM_ENVS[options.controller]]
        if options.part == "train":
            sizes.append(preset("fast", options.robot, options.controller).ppo.minibatch)
        machine.set_up(machine.shards(*sizes))
        result = measure(options)
        devices = provenance.devices()
        result |= {"devices": devices["count"], "device_kind": devices["kind"], "versions": provenance.versions()}
        show(result, table(result))
    return 0


def check(options: Options, args: Sequence[str]) -> None:
    """Refuses options that the part would not look at.

    Raises:
        UserError: naming the first.
    """
    for name, _ in words.given(args):
        parts = READ.get(name)
        if parts is not None and options.part not in parts:
            raise UserError(f"{name} is for bench {' and '.join(parts)}, not for bench {options.part}")


def learn(options: Options, show: Show) -> int:
    """Trains a policy, or goes on training, and shows when it reached the paper's figures."""
    from loco_mjx.cli import train
    from loco_mjx.compare.time_to_paper import milestones, times
    from loco_mjx.run import directory

    wanted = milestones(options.task)
    name = f"{options.method}-seed{options.seed}"
    out = options.out or Path("runs", "learn", options.task, options.policy, name)
    others = [milestone.evaluated_on for milestone in wanted if milestone.evaluated_on != options.task]
    command = ["--task", options.task, "--policy", options.policy, "--method", options.method]
    command += ["--seed", str(options.seed), "--out", str(out), *EVALUATED]
    command += ["--eval-tasks", ",".join(others)] if others else []
    command += ["--total-steps", str(options.total_steps)] if options.total_steps is not None else []
    command += ["--num-envs", str(options.num_envs)] if options.num_envs is not None else []
    code = train.main(command)
    if code == 0:
        result = {"bench": "learn", "task": options.task, "policy": options.policy, "method": options.method}
        result |= {"seed": options.seed} | times(out, wanted)
        info = directory.read_json(out / directory.INFO)
        result |= {name: info[name] for name in ("devices", "versions", "machine")}
        show(result, learnt(result))
    return code


def learnt(result: dict[str, Any]) -> Any:
    """When the paper's figures were reached, as people read it."""
    from rich.table import Table

    teacher = f", of which its teacher's {result['teacher_minutes']:.1f}" if result["teacher_samples"] else ""
    title = f"{result['policy']} on {result['task']} by {result['method']}: {result['samples']:,} samples"
    table = Table(
        "evaluated on",
        "paper, m",
        "best, m",
        "reached after samples",
        "minutes of training",
        title=f"{title} in {result['minutes']:.1f} minutes{teacher}",
        title_justify="left",
    )
    for one in result["milestones"]:
        when = (f"{one['samples']:,}", f"{one['minutes']:.1f}") if one["reached"] else ("not reached", "")
        best = "" if one["best"] is None else f"{one['best']:.1f}"
        table.add_row(one["evaluated_on"], f"{one['metres']:.1f}", best, *when)
    return table


def measure(options: Options) -> dict[str, Any]:
    """The figures of one part."""
    num_envs = options.num_envs or NUM_ENVS[options.controller]
    where = {} if options.part == "mpc" else {"task": options.task}
    what = {"bench": options.part} | where | {"robot": options.robot, "num_envs": num_envs}
    what |= {"controller": options.controller} if options.part in READ["--controller"] else {}
    if options.part == "depth":
        from loco_mjx.bench.depth import bench_depth

        return what | bench_depth(options.task, num_envs, options.seconds, options.robot)
    if options.part == "physics":
        from loco_mjx.bench.physics import bench_physics

        return what | bench_physics(options.task, num_envs, options.seconds, robot=options.robot)
    if options.part == "mpc":
        from loco_mjx.bench.mpc import bench_mpc

        return what | bench_mpc(num_envs, options.seconds, options.robot)
    from loco_mjx.bench import training

    config = training.bench_config(options.task, options.policy, num_envs, options.robot, options.controller)
    if options.seeds is not None:
        return what | training.bench_seeds(config, options.seconds, options.seeds)
    run = training.bench_env if options.part == "env" else training.bench_train
    return what | run(config, options.seconds)


def table(result: dict[str, Any]) -> Any:
    """The figures as people read them."""
    from rich.table import Table

    table = Table(
        title=" on ".join(result[key] for key in ("bench", "task") if key in result),
        title_justify="left",
        show_header=False,
    )
    for name, value in result.items():
        if isinstance(value, dict):
            value = ", ".join(f"{key} {_short(part)}" for key, part in value.items())
        table.add_row(name, _short(value))
    return table


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
    return str(value)
