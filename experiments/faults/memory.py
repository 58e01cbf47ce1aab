"""Whether a run's memory grows as it goes on."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from experiments.faults import training
from loco_mjx.run import start

FLAT = 8.0  # MB by which the later mean may be more than the earlier one
EARLY, LATE = (0.2, 0.4), (0.8, 1.0)  # parts of the run that are compared
CHECKPOINT_MINUTES = "0.05"  # so that it saves many times


def resident() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Trains for so many iterations, with checkpoints, rows and events, and compares early and late memory."""
    out = folder / "long"
    weights: list[float] = []  # MB, after every iteration
    watched = training.Watched(training.trainer(out)[0], lambda state: weights.append(resident()))
    start.build = lambda config: watched
    code, said = training.run(out, count, "--checkpoint-minutes", CHECKPOINT_MINUTES)
    assert code == 0, said
    means = [_mean(weights, part) for part in (EARLY, LATE)]
    growth = means[1] - means[0]
    problems = [f"memory grew by {growth:.1f} MB"] if growth > FLAT else []
    figures = {"early_mb": round(means[0], 1), "late_mb": round(means[1], 1), "growth_mb": round(growth, 1)}
    return {"iterations": count} | figures | {"problems": problems}


def _mean(weights: list[float], part: tuple[float, float]) -> float:
    first, last = (round(end * len(weights)) for end in part)
    return sum(weights[first:last]) / (last - first)
