"""`loco-mjx simcheck`: the same exported policy in C MuJoCo and in MJX, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from loco_mjx import policies
from loco_mjx.cli.output import one_object
from loco_mjx.cli.parse import parse
from loco_mjx.ranges import COUNT, SEED, Range

PROG = "loco-mjx simcheck"
Iterations = Annotated[int, Range(1, 1000)]


@dataclass(frozen=True)
class Options:
    """Runs an exported policy in full C MuJoCo and in our environment, in the same scenes, and compares the two."""

    policy: tyro.conf.Positional[Path]
    """Folder that `loco-mjx export` wrote, or the name of a shipped policy."""
    task: str | None = None
    """Task to run on; None: the one it was trained on."""
    episodes: COUNT = 32
    """Episodes, each in a newly generated scene."""
    seed: SEED = 0
    """Seed of the scenes; the same as in `loco-mjx evaluate`."""
    solver: tuple[Iterations, Iterations] | None = None
    """Newton and line-search iterations of our side's physics; None: those of training."""
    prisms: bool = False
    """Leave C MuJoCo's own contacts with a heightfield, which push deep feet sideways; else planes, as in training."""
    json: bool = False
    """Print one JSON object and nothing else on stdout."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if the folder cannot be used, or what is asked cannot be done.
    """
    options = parse(Options, args, PROG)
    with one_object(options.json) as show:
        from loco_mjx.run import machine

        machine.set_up()
        from loco_mjx.simcheck import report
        from loco_mjx.simcheck.run import simcheck

        progress = report.Progress()
        where = policies.find(options.policy)
        how = (options.task, options.episodes, options.seed, progress, options.solver, options.prisms)
        result = simcheck(where, *how)
        show(result, report.table(result))
    return 0
