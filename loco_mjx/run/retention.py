"""Which checkpoints of a run are kept: Orbax's policies decide."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

from loco_mjx.run.checkpoint_files import path_of, score_of, steps

LATEST = 2  # how many of the newest are kept


@dataclass(frozen=True)
class _Info:
    """What Orbax's policies read of a checkpoint."""

    step: int
    metrics: dict[str, Any] | None
    time: datetime.datetime


def kept(directory: Path, every: int | None, per_iteration: int) -> set[int]:
    """The steps of the checkpoints that are kept: the last two, the best, and the first ones after every so often.

    Args:
        directory: of the run.
        every: samples between those that are kept for good; None: none is.
        per_iteration: samples of an iteration.
    """
    from orbax.checkpoint import checkpoint_managers as managers

    there = sorted(steps(directory))
    scores = {step: score_of(path_of(directory, step)) for step in there}
    infos = [
        _Info(step, None if score is None else {"score": score}, datetime.datetime.fromtimestamp(0, datetime.UTC))
        for step, score in scores.items()
    ]
    policies = [
        managers.LatestN(LATEST),
        managers.BestN(n=1, get_metric_fn=itemgetter("score"), keep_checkpoints_without_metrics=False),
        managers.CustomSteps([step for step in there if passes(step, every, per_iteration)]),
    ]
    keep = managers.AnyPreservationPolicy(policies).should_preserve(infos, context=managers.PreservationContext())
    return {step for step, stays in zip(there, keep, strict=True) if stays}


def passes(step: int, every: int | None, per_iteration: int) -> bool:
    """Whether the iteration that ended at a step went past a multiple of `every` samples."""
    return every is not None and step > 0 and step % every < per_iteration
