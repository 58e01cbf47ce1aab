"""`loco-mjx evaluate`: runs a trained policy for episodes on any task and reports the metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from loco_mjx.cli.options import Step
from loco_mjx.cli.output import one_object
from loco_mjx.cli.parse import parse
from loco_mjx.ranges import COUNT, SEED

PROG = "loco-mjx evaluate"


@dataclass(frozen=True)
class Options:
    """Evaluates the policy of a run; by default without noise, on the task it was trained on.

    A directory that holds a method's runs, one per seed, gives mean and deviation over the seeds.
    """

    directory: tyro.conf.Positional[Path]
    """The run's directory, that of the runs of several seeds, a policy's folder, or the name of a shipped policy."""
    task: str | None = None
    """Task to evaluate on; None: the one it was trained on."""
    episodes: COUNT = 32
    """Episodes, each in a newly generated scene."""
    seed: SEED = 0
    """Seed of the scenes; the same seed gives the same episodes."""
    stochastic: bool = False
    """Draw actions from the policy's Gaussian instead of taking its mean."""
    randomize: bool = False
    """Draw dynamics, latency and blind pixels for each episode."""
    step: Step = None
    """Which checkpoint of the run: the samples trained at it, or best by evaluation; None: the newest."""
    json: bool = False
    """Print one JSON object and nothing else."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if there is no usable run, or what is asked cannot be done; nothing is written then.
    """
    options = parse(Options, args, PROG, names=("tasks",))
    with one_object(options.json) as show:
        from loco_mjx.run import machine

        machine.set_up()
        from loco_mjx import api
        from loco_mjx.evaluation import multi_seed, report

        result = api.evaluate(
            options.directory,
            options.task,
            options.episodes,
            options.seed,
            options.stochastic,
            options.randomize,
            options.step,
        )
        show(result, (multi_seed if "seeds_trained" in result else report).table(result))
    return 0
