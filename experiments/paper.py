"""The paper's experiments as data, and the command that runs them: ``python -m experiments.paper``, or `make paper`.

It goes on where it stopped, and ends with the tables and the curves. `--scale 0.01` is the same at a hundredth of the
samples. Below a scale of 0.001 nothing is learnt any more, and nearly all of the time is compilation: what is left then
shows that every part runs, with every task, every policy and every ablation once instead of in all combinations.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from loco_mjx.cli import curves, table
from loco_mjx.compare import launch, paper
from loco_mjx.compare.cells import Cell, Plan
from loco_mjx.compare.launch import Launcher, Local
from loco_mjx.errors import UserError
from loco_mjx.run.schedule import LoopOptions
from loco_mjx.run.variant import Variant

POLICIES = tuple(paper.POLICIES.values())
SEEDS = (0, 1, 2, 3, 4)
SAMPLES = 15_000_000
EPISODES = 100
SMOKE_SCALE = 0.001  # below it only one seed, two short episodes, and none while training
SMOKE_EPISODES = 2
SMOKE_CHANGES = (("env.horizon", "100"),)
SMOKE_LOOP = LoopOptions(evaluations=0)


@dataclass(frozen=True)
class Experiment:
    """Policies trained on tasks and evaluated on tasks.

    Attributes:
        name: of the experiment.
        tables: of the paper that it fills.
        tasks: to train on.
        eval_tasks: on which every run is evaluated at its end.
        variants: policies to train.
        preset: of the configuration.
        seeds: of each.
        samples: environment steps of each run.
        episodes: of each evaluation.
        changes: keys of the configuration and their values.
        loop: when runs are saved and evaluated while they train.
    """

    name: str
    tables: tuple[int, ...]
    tasks: tuple[str, ...]
    eval_tasks: tuple[str, ...]
    variants: tuple[Variant, ...] = POLICIES
    preset: str = "paper"
    seeds: tuple[int, ...] = SEEDS
    samples: int = SAMPLES
    episodes: int = EPISODES
    changes: tuple[tuple[str, str], ...] = ()
    loop: LoopOptions = field(default_factory=LoopOptions)

    def scaled(self, scale: float) -> Experiment:
        """The same with another number of samples."""
        smaller = dataclasses.replace(self, samples=max(1, math.ceil(self.samples * scale)))
        if scale >= SMOKE_SCALE:
            return smaller
        few = {"seeds": self.seeds[:1], "episodes": SMOKE_EPISODES, "changes": SMOKE_CHANGES, "loop": SMOKE_LOOP}
        return dataclasses.replace(smaller, **few)

    def cells(self, out: Path) -> list[Cell]:
        """Its runs."""
        plan = Plan(out, self.preset, self.samples, self.eval_tasks, self.episodes, self.changes, self.loop)
        return plan.cells(self.tasks, self.variants, self.seeds)


EXPERIMENTS = (
    Experiment("generalization", (1,), ("thin", "wide"), ("thin", "wide")),
    Experiment("thin-sphere", (2, 4), ("thin-sphere",), ("thin-sphere",)),
    Experiment("wide-sphere", (2,), ("wide-sphere",), ("wide-sphere",)),
    Experiment("moving", (3,), ("moving",), ("moving",)),
    Experiment(
        "ablation",
        (4,),
        ("thin-sphere",),
        ("thin-sphere",),
        tuple(row.variant for row in paper.ABLATION.rows if row.variant.changes),  # the unchanged one is in thin-sphere
    ),
    Experiment("mountain", (5,), ("mountain",), ("mountain",)),
)


def cells_of(names: list[str], out: Path, scale: float, preset: str | None = None) -> list[Cell]:
    """The runs of some experiments; every experiment's first seed comes before the second.

    Raises:
        UserError: if an experiment is unknown, or the scale is no size.
    """
    if not 0 < scale < math.inf:
        raise UserError(f"scale is {scale:g}; accepted: more than 0, e.g. 0.01 for a hundredth of the samples")
    known = {experiment.name: experiment for experiment in EXPERIMENTS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise UserError(f"unknown experiment '{unknown[0]}'; accepted: {', '.join(known)}")
    chosen = [known[name].scaled(scale) for name in names or known]
    chosen = [dataclasses.replace(one, preset=preset or one.preset) for one in chosen]
    cells = sorted((cell for one in chosen for cell in one.cells(out)), key=lambda cell: cell.seed)
    return cells if scale >= SMOKE_SCALE else once_each(cells)


def once_each(cells: list[Cell]) -> list[Cell]:
    """The fewest that have every task and every variant: the paper's own policy on every task, the others on one."""
    seen: set[object] = set()
    kept = []
    for cell in sorted(cells, key=lambda cell: cell.variant != paper.POLICIES["LocoTransformer"]):
        if not {cell.task, cell.variant} <= seen:
            seen |= {cell.task, cell.variant}
            kept.append(cell)
    return [cell for cell in cells if cell in kept]


def launcher(name: str) -> Launcher:
    """Where the runs go; a Ray cluster is found as `loco-mjx sweep` finds it.

    Raises:
        UserError: if Ray is asked for and missing.
    """
    if name == "local":
        return Local()
    from loco_mjx.compare.ray_launcher import OnRay

    return OnRay()


def main() -> int:
    """Runs the experiments that the command line names, or all; then writes the tables and the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="of experiments; none: all")
    parser.add_argument("--scale", type=float, default=1.0, help="of the number of samples")
    parser.add_argument("--preset", default=None, help="another than the paper's")
    parser.add_argument(
        "--out", type=Path, default=None, help="directory; none: runs/paper, with the scale in its name"
    )
    parser.add_argument("--launcher", choices=("local", "ray"), default="local", help="where runs go")
    parser.add_argument("--dry-run", action="store_true", help="only show what would run, and how long")
    options = parser.parse_args()
    out = options.out or Path("runs", "paper" if options.scale == 1 else f"paper-{options.scale:g}")
    try:
        cells = cells_of(options.names, out, options.scale, options.preset)
        result = launch.sweep(cells, Console(), launcher(options.launcher), options.dry_run)
        if not options.dry_run and (result.ran or result.skipped):
            table.main([str(out)])
            curves.main([str(out)])
    except UserError as error:
        print(f"paper: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("paper: stopped; the same command goes on", file=sys.stderr)
        return 130
    return 1 if result.failed else 0


if __name__ == "__main__":
    sys.exit(main())
