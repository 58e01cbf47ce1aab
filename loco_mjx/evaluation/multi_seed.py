"""An evaluation of one method's seeds: each run by itself, then mean and standard deviation over the runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from loco_mjx.errors import UserError
from loco_mjx.evaluation import report
from loco_mjx.evaluation.display import NOTHING, caption, order
from loco_mjx.run import results
from loco_mjx.run.directory import CONFIG


def holds_seeds(directory: Path) -> bool:
    """Whether a directory is no run itself, but holds runs."""
    return not (directory / CONFIG).exists() and any(directory.glob(f"*/{CONFIG}"))


def evaluate(directory: Path, task: str | None, **options: Any) -> dict[str, Any]:
    """Evaluates every run in a directory in the same scenes, and writes the result into its `evaluation/`.

    Args:
        directory: holds the runs; they may differ in seed alone.
        task: to evaluate on; None: the one they were trained on.
        options: of :func:`loco_mjx.evaluation.report.evaluate`.

    Returns:
        As for one run, but `metrics` holds mean and std over the seeds, and `seeds` each one's own mean.

    Raises:
        UserError: if a run cannot be used, or they are not of one method.
    """
    runs = [run for run in results.find_runs(directory) if run.path.parent == directory]
    results.check_same_method(runs, f"{runs[0].config.policy} on {runs[0].config.env.task}")
    found = [report.evaluate(run.path, task, **options) for run in runs]
    samples = sorted({one["samples"] for one in found})
    if len(samples) > 1:
        raise UserError(
            f"the runs in {directory} stand at {samples[0]:,} to {samples[-1]:,} samples; finish them first"
        )
    shared = {key: found[0][key] for key in found[0] if key not in ("run", "metrics", "episodes")}
    names = [name for name in found[0]["metrics"] if all(name in one["metrics"] for one in found)]
    result = shared | {
        "run": str(directory),
        "seeds_trained": [run.config.seed for run in runs],
        "metrics": {name: _over_seeds([one["metrics"][name]["mean"] for one in found]) for name in names},
    }
    report.keep(directory, result)
    return result


def table(result: dict[str, Any]) -> Table:
    """The result as people read it: mean ± standard deviation over seeds, the seeds' own means beside them."""
    seeds = result["seeds_trained"]
    trained = f"{result['policy']} trained on {result['trained_on']} ({result['samples']:,} samples)"
    title = f"{trained}, on {result['task']}: {len(seeds)} seeds, {result['num_episodes']} episodes each"
    shown, zero = order(result["metrics"], result["task"])
    table = Table(title=title, title_justify="left", caption=caption(zero), caption_justify="left")
    table.add_column("metric")
    for name in ("mean", "std over seeds", *(f"seed {seed}" for seed in seeds)):
        table.add_column(name, justify="right")
    for one in shown:
        figures = result["metrics"].get(one.name)
        own = [NOTHING] * len(seeds) if figures is None else [one.value(value) for value in figures["seeds"]]
        table.add_row(one.label, one.mean(figures), one.std(figures), *own)
    return table


def _over_seeds(values: list[float]) -> dict[str, Any]:
    found = results.over_seeds(values)
    return {"mean": found.mean, "std": found.std, "seeds": list(found.values)}
