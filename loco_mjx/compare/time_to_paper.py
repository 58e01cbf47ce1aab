"""How long a run took to the paper's figures: samples and minutes of training, read from its own curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from loco_mjx.compare.paper import DISTANCE, TABLES
from loco_mjx.errors import UserError
from loco_mjx.run import directory, metrics_csv

RATE = "time/samples_per_second"  # of an iteration, without evaluations
SAMPLES, SECONDS = "samples", "seconds"


@dataclass(frozen=True)
class Milestone:
    """A distance that the paper reports for LocoTransformer.

    Attributes:
        trained_on: task.
        evaluated_on: the same task, or another.
        metres: the paper's mean.
    """

    trained_on: str
    evaluated_on: str
    metres: float

    @property
    def column(self) -> str:
        """Where `metrics.csv` has it."""
        own = self.evaluated_on == self.trained_on
        return f"eval/{DISTANCE}" if own else f"eval/{self.evaluated_on}/{DISTANCE}"


def milestones(task: str) -> list[Milestone]:
    """The paper's distances of LocoTransformer trained on a task: in its table 1, 3 or 5.

    Raises:
        UserError: if the paper has none.
    """
    found = [
        Milestone(task, column.evaluated_on, value[0])
        for table in TABLES
        for row in table.rows
        for column, value in zip(table.columns, row.values, strict=True)
        if row.label == "LocoTransformer" and column.trained_on == task and column.metric == DISTANCE and value
    ]
    known = sorted({column.trained_on for table in TABLES for column in table.columns if column.metric == DISTANCE})
    if not found:
        raise UserError(f"the paper gives no distance for '{task}'; accepted: {', '.join(known)}")
    return found


def times(path: Path, milestones: Sequence[Milestone]) -> dict[str, Any]:
    """When a run first reached each milestone; its teacher's whole training counts, where it has one.

    Minutes are of training alone: the iterations, without evaluations and checkpoints, and with an iteration
    that compiles, the first of every start, counted as the others' median.

    Args:
        path: of the run.
        milestones: to look for.

    Returns:
        `samples`, `minutes`, `teacher_samples` and `teacher_minutes` of all of the run, and `milestones`, each with
        `reached`, `best` (m; None where it was never evaluated) and, where it is reached, its own `samples` and
        `minutes` (the teacher's included).

    Raises:
        UserError: if the run has no curves.
    """
    curve = _curve(path)
    teacher = path / directory.TEACHER
    before = _curve(teacher)[-1] if (teacher / directory.CONFIG).exists() else {SAMPLES: 0, SECONDS: 0.0}
    whole = {
        "samples": curve[-1][SAMPLES],
        "minutes": (before[SECONDS] + curve[-1][SECONDS]) / 60.0,
        "teacher_samples": before[SAMPLES],
        "teacher_minutes": before[SECONDS] / 60.0,
    }
    return whole | {"milestones": [_reached(curve, milestone, before[SECONDS]) for milestone in milestones]}


def _reached(curve: list[dict[str, Any]], milestone: Milestone, seconds: float) -> dict[str, Any]:
    values = [(row, float(row["row"][milestone.column])) for row in curve if row["row"].get(milestone.column)]
    first = next((row for row, value in values if value >= milestone.metres), None)
    best = max((value for _, value in values), default=None)
    found = asdict(milestone) | {"reached": first is not None, "best": best}
    if first is not None:
        found |= {"samples": first[SAMPLES], "minutes": (seconds + first[SECONDS]) / 60.0}
    return found


def _curve(path: Path) -> list[dict[str, Any]]:
    """A run's rows, with the samples and the seconds of training until the end of each."""
    rows = metrics_csv.read(path / "metrics.csv")
    if not rows:
        raise UserError(f"{path} has no learning curve yet; train it first")
    samples = [int(row[metrics_csv.STEP]) for row in rows]
    sizes = [now - before for before, now in zip([0, *samples], samples, strict=False)]
    seconds = [size / float(row[RATE]) for size, row in zip(sizes, rows, strict=True)]
    info = directory.read_json(path / directory.INFO)
    begun = {0, *(start[SAMPLES] for start in info.get("resumed", []))}
    compiled = [now - size in begun for now, size in zip(samples, sizes, strict=True)]
    usual = median([s for s, compiles in zip(seconds, compiled, strict=True) if not compiles] or seconds)
    total, curve = 0.0, []
    for row, sample, took, compiles in zip(rows, samples, seconds, compiled, strict=True):
        total += min(took, usual) if compiles else took
        curve.append({"row": row, SAMPLES: sample, SECONDS: total})
    return curve
