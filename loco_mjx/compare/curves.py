"""Training and evaluation curves over seeds, as PNG and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loco_mjx.errors import UserError
from loco_mjx.run import results
from loco_mjx.run.logger import CSV, STEP, read_rows
from loco_mjx.run.results import Run
from loco_mjx.scene.tasks import TASKS

# Title, unit, metric in metrics.csv: exploring in training, and acting by the mean in evaluations during it.
PANELS = (
    ("training: return", "", "episode/return"),
    ("training: distance", "m", "episode/distance"),
    ("evaluation: return", "", "eval/return"),
    ("evaluation: distance", "m", "eval/distance"),
)
# The same of every other task that was evaluated on during training (`--eval-tasks`): the paper's figure 3b.
ELSEWHERE = (("distance", "m", "eval/{}/distance"), ("collisions", "steps", "eval/{}/collisions"))
FORMATS = ("png", "svg")


@dataclass(frozen=True)
class Curve:
    """A metric over samples: mean and standard deviation over seeds.

    Attributes:
        steps: samples, (points,).
        mean: (points,).
        std: (points,), the population's.
        seeds: how many it stands on.
    """

    steps: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    seeds: int


def read_curve(run: Run, metric: str) -> tuple[np.ndarray, np.ndarray]:
    """A metric of a run where it has one: samples and values, (points,) each.

    Raises:
        UserError: if a cell of metrics.csv is no number.
    """
    rows = [row for row in read_rows(run.path / CSV) if row.get(metric)]
    try:
        values = np.array([float(row[metric]) for row in rows])
    except ValueError as error:
        raise UserError(f"{run.path / CSV}: {error}; restore it, or leave the run out") from error
    return np.array([int(row[STEP]) for row in rows]), values


def over_seeds(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> Curve | None:
    """Mean and deviation over the range of samples that all seeds cover, at the points of the seed with fewest.

    Between its own points a seed is interpolated linearly. None if there are no curves or no common range.
    """
    curves = [curve for curve in curves if len(curve[0])]
    if not curves:
        return None
    low, high = max(steps[0] for steps, _ in curves), min(steps[-1] for steps, _ in curves)
    grids = [steps[(steps >= low) & (steps <= high)] for steps, _ in curves]
    grid = min((grid for grid in grids if len(grid)), key=len, default=None)
    if grid is None:
        return None
    values = np.stack([np.interp(grid, steps, value) for steps, value in curves])
    return Curve(grid, values.mean(0), values.std(0), len(curves))


def draw(folder: Path, out: Path, mixed_versions: bool = False) -> tuple[list[Path], list[str]]:
    """Draws one figure per task trained on, a line per policy.

    Args:
        folder: of the runs.
        out: directory for TASK.png and TASK.svg.
        mixed_versions: accept runs trained with different versions.

    Returns:
        The files written, and notes on what is missing.

    Raises:
        UserError: if there are no runs, none with a curve, or they cannot be compared.
    """
    runs = results.find_runs(folder)
    if not mixed_versions:
        results.check_versions(results.trained_with(runs), "draw those of each version apart")
    groups = _groups(runs)
    shown = {task: panels([run for runs in methods.values() for run in runs]) for task, methods in groups.items()}
    found = {
        task: {label: [over_seeds([read_curve(run, metric) for run in runs]) for _, _, metric in shown[task]]
               for label, runs in methods.items()}
        for task, methods in groups.items()
    }  # fmt: skip
    notes = [f"no curve yet: {label} on {task}" for task in found for label, c in found[task].items() if not any(c)]
    drawn = {task: {label: c for label, c in methods.items() if any(c)} for task, methods in found.items()}
    files = [path for task, methods in drawn.items() if methods for path in _figure(task, shown[task], methods, out)]
    if not files:
        count = sum(len(runs) for methods in groups.values() for runs in methods.values())
        raise UserError(f"none of the runs in {folder} ({count}) has a curve yet; let one train for an iteration")
    return files, notes


def panels(runs: Sequence[Run]) -> list[tuple[str, str, str]]:
    """What is drawn of runs: title, unit and metric; two more for each other task that one was evaluated on."""
    columns = {name for run in runs for row in read_rows(run.path / CSV) for name, value in row.items() if value}
    more = [
        (f"evaluation on {task}: {title}", unit, metric.format(task))
        for task in TASKS
        if ELSEWHERE[0][2].format(task) in columns
        for title, unit, metric in ELSEWHERE
    ]
    return [*PANELS, *more]


def _groups(runs: Sequence[Run]) -> dict[str, dict[str, list[Run]]]:
    """Runs by task and by what differs between methods."""
    groups: dict[str, dict[str, list[Run]]] = {}
    for run in runs:
        methods = groups.setdefault(run.config.env.task, {})
        methods.setdefault(results.variant_of(run.flat).label, []).append(run)
    for task, methods in groups.items():
        for label, members in methods.items():
            results.check_same_method(members, f"{label} on {task}")
    return groups


def _figure(
    task: str, shown: Sequence[tuple[str, str, str]], methods: dict[str, list[Curve | None]], out: Path
) -> list[Path]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import EngFormatter

    lines = len(shown) // 2
    figure, axes = plt.subplots(lines, 2, figsize=(11, 3.5 * lines), constrained_layout=True)
    for i, (panel, axis) in enumerate(zip(shown, axes.flat, strict=True)):
        for color, (label, curves) in enumerate(methods.items()):
            draw_line(axis, curves[i], label, f"C{color}")
        axis.set(title=panel[0], xlabel="samples", ylabel=panel[1])
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=8)
    figure.suptitle(f"{task}: mean and standard deviation over seeds")
    files = [out / f"{task}.{kind}" for kind in FORMATS]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path in files:
            figure.savefig(path, dpi=110)
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror or error}; choose a writable directory") from error
    finally:
        plt.close(figure)
    return files


def draw_line(axis: Any, curve: Curve | None, label: str, color: str) -> None:
    """Draws a curve with its deviation; nothing without one."""
    if curve is None:
        return
    seeds = f"{curve.seeds} seed" + ("" if curve.seeds == 1 else "s")
    marker = "o" if len(curve.steps) <= 20 else None
    axis.plot(curve.steps, curve.mean, color=color, label=f"{label}, {seeds}", marker=marker, markersize=3)
    if curve.seeds > 1:
        axis.fill_between(curve.steps, curve.mean - curve.std, curve.mean + curve.std, color=color, alpha=0.2, lw=0)
