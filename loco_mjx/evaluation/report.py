"""An evaluation of a run: which policy, on what, and what came of it; kept beside the run."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rich.table import Table

from loco_mjx.env import LocoEnv
from loco_mjx.errors import UserError
from loco_mjx.evaluation.display import UNITS as UNITS  # others name units alike
from loco_mjx.evaluation.display import caption, order
from loco_mjx.evaluation.episodes import Evaluator, evaluation_config, summarize
from loco_mjx.run import provenance
from loco_mjx.run.directory import write_json
from loco_mjx.run.policy import TrainedPolicy, load_policy
from loco_mjx.scene.tasks import get_task
from loco_mjx.sharding import make_mesh

EVALUATION = "evaluation"


def evaluate(
    directory: Path,
    task: str | None = None,
    episodes: int = 32,
    seed: int = 0,
    stochastic: bool = False,
    randomize: bool = False,
    step: int | str | None = None,
) -> dict[str, Any]:
    """Evaluates the policy of a run, and writes the result into the run's `evaluation/`.

    Args:
        directory: the run's.
        task: to evaluate on; None: the one it was trained on.
        episodes: how many.
        seed: of the scenes and of whatever else is random.
        stochastic: draw actions instead of taking the mean.
        randomize: draw dynamics, latency and blind pixels.
        step: which of its checkpoints, as for :func:`loco_mjx.run.policy.load_policy`.

    Returns:
        What was evaluated, `metrics` with mean and std over the episodes, `episodes` with each one's figures.

    Raises:
        UserError: if there is no usable run, the task is unknown, or there are no episodes to run.
    """
    if task is not None:
        get_task(task)  # refuses an unknown name before anything is read
    result = evaluate_policy(load_policy(directory, step), str(directory), task, episodes, seed, stochastic, randomize)
    keep(directory, result)
    return result


def evaluate_policy(
    policy: TrainedPolicy, name: str, task: str | None, episodes: int, seed: int, stochastic: bool, randomize: bool
) -> dict[str, Any]:
    """The same of a policy at hand, written nowhere; `name` is what the result calls it."""
    config = evaluation_config(policy.config.env, task, randomize)
    env = LocoEnv(config)
    program = Evaluator(env, policy.networks, config.horizon, make_mesh(), deterministic=not stochastic)
    figures = program.run(policy.params, policy.normalizer, seed, episodes)
    return {
        "run": name,
        "policy": policy.config.policy,
        "trained_on": policy.config.env.task,
        "samples": policy.samples,
        "task": config.task,
        "num_episodes": episodes,
        "seed": seed,
        "deterministic": not stochastic,
        "randomized": randomize,
        "metrics": summarize(figures),
        "episodes": {name: values.tolist() for name, values in figures.items()},
        "versions": provenance.versions(),
    }


def keep(directory: Path, result: dict[str, Any]) -> None:
    """Writes a result into the `evaluation/` of a directory, named by what was evaluated."""
    marks = ("" if result["deterministic"] else "-stochastic") + ("-randomized" if result["randomized"] else "")
    name = f"{result['task']}{marks}-{result['samples']}-seed{result['seed']}.json"
    try:
        write_json(directory / EVALUATION / name, result)
    except UserError as error:  # someone else's run may be read only; the result is shown all the same
        print(f"loco-mjx: not kept: {error}", file=sys.stderr)


def table(result: dict[str, Any]) -> Table:
    """The result as people read it: what matters first; what was zero in every episode is named below."""
    how = "deterministic" if result["deterministic"] else "stochastic"
    trained = f"{result['policy']} trained on {result['trained_on']} ({result['samples']:,} samples)"
    title = f"{trained}, on {result['task']}: {result['num_episodes']} episodes, {how}"
    shown, zero = order(result["metrics"], result["task"])
    table = Table(title=title, title_justify="left", caption=caption(zero), caption_justify="left")
    table.add_column("metric")
    table.add_column("mean", justify="right")
    table.add_column("std", justify="right")
    for one in shown:
        figures = result["metrics"].get(one.name)
        table.add_row(one.label, one.mean(figures), one.std(figures))
    return table
