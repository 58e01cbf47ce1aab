"""An evaluation of one method's seeds: each run by itself, then mean and standard deviation over the runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from loco_mjx.errors import UserError
from loco_mjx.evaluation import report
from loco_mjx.evaluation.display import NOTHING, caption, order
from loco_mjx.run import checkpoint, results
from loco_mjx.run.directory import CONFIG


def holds_seeds(directory: Path) -> bool:
    """Whether a directory is no run itself, but holds runs."""
    if (directory / CONFIG).exists():
        return False
    return any(not results.is_teacher(path.parent) for path in directory.glob(f"*/{CONFIG}"))


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
    if options.get("step") is None:
        stand = sorted({checkpoint.newest(run.path) for run in runs})
        if len(stand) > 1:
            raise UserError(
                f"the runs in {directory} stand at {stand[0]:,} to {stand[-1]:,} samples; finish them first"
            )
    found = [report.evaluate(run.path, task, **options) for run in runs]
    shared = {key: found[0][key] for key in found[0] if key not in ("run", "metrics", "episodes")}
    names = [name for name in found[0]["metrics"] if all(name in one["metrics"] for one in found)]
    result = shared | {
        "run": str(directory),
        "seeds_trained": [run.config.seed for run in runs],
        "samples": max(one["samples"] for one in found),
        "samples_of_seeds": [one["samples"] for one in found],  # each one's best may be another
        "metrics": {name: _over_seeds([one["metrics"][name]["mean"] for one in found]) for name in names},
    }
    report.keep(directory, result)
    return result


def table(result: dict[str, Any]) -> Table:
    """The result as people read it: mean ± standard deviation over seeds, the seeds' own means beside them."""
    seeds = result["seeds_trained"]
    least = min(result.get("samples_of_seeds", [result["samples"]]))
    samples = f"{result['samples']:,}" if least == result["samples"] else f"{least:,} to {result['samples']:,}"
    trained = f"{result['policy']} trained on {result['trained_on']} ({samples} samples)"
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
