"""A comparison as people read it, and its progress."""

from __future__ import annotations

import sys
import time
from typing import Any

from rich.console import Console, Group
from rich.table import Table

from loco_mjx.evaluation.report import UNITS
from loco_mjx.run.progress import LINE_SECONDS, duration

COMPILING = 3  # control steps of a side that hold its compilation
CAPTION = "difference: C − MJX, ± standard error of its mean"
FIRST = ("distance", "collisions", "return")  # shown first; the others follow


def table(result: dict[str, Any]) -> Group:
    """The comparison: of whole episodes, and of seconds replayed."""
    trained = f"{result['policy']} trained on {result['trained_on']} ({result['samples']:,} samples)"
    title = f"{trained}, on {result['task']}: {result['num_episodes']} episodes in the same scenes"
    metrics = result["metrics"]
    others = [name for name in metrics if name not in FIRST and any(metrics[name].values())]  # something of it happened
    return Group(title, _rows(metrics, [*FIRST, *others], 2), CAPTION, *_replay(result["replay"]))


def _replay(found: dict[str, Any]) -> list[Table | str]:
    """Nothing where no episode lasted for a second."""
    if not found["windows"]:
        return []
    title = f"{found['windows']:,} times {found['seconds']:g} s of MJX's episodes again in C, from the same state"
    away, said = found["targets"], "The policy holds what it sees for too long for its targets to be compared."
    if away is not None:
        amount = f"{away['mean']:.1e} {found['unit']} in the mean, {away['max']:.1e} at most"
        said = f"On C's observations of them the policy's {found['output']} differ by {amount}."
    return ["", title, _rows(found, ["distance", "contacts"], 4), said]


def _rows(metrics: dict[str, Any], names: list[str], digits: int) -> Table:
    table = Table()
    table.add_column("metric")
    for name in ("C MuJoCo", "MJX", "ratio", "difference"):
        table.add_column(name, justify="right")
    for name in names:
        row = metrics[name]
        unit = f", {UNITS[name]}" if name in UNITS else ""
        sides = [f"{row[f'{side}_mean']:.{digits}f} ± {row[f'{side}_std']:.{digits}f}" for side in ("c", "mjx")]
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.{digits + 1}f}"
        error = "" if row["standard_error"] is None else f" ± {row['standard_error']:.{digits}f}"
        table.add_row(name + unit, *sides, ratio, f"{row['difference']:+.{digits}f}{error}")
    return table


class Progress:
    """A line on stderr every few seconds: which side, how far, how long it will take at most."""

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr)
        self._begin = self._shown = 0.0

    def __call__(self, side: str, done: int, total: int) -> None:
        """Takes in a control step. The time is counted from the side's third one: those before hold compilations."""
        now = time.monotonic()
        if done <= COMPILING:
            self._begin = self._shown = now
        if now - self._shown < LINE_SECONDS:
            return
        self._shown = now
        left = (now - self._begin) / (done - COMPILING) * (total - done)
        text = f"{side}: {done:,}/{total:,} control steps, {duration(left)} left at most"
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
