"""When a run saves, and when it evaluates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from loco_mjx.config.quantities import TotalSteps
from loco_mjx.ranges import COUNT, Range
from loco_mjx.run import retention

Evaluate = Callable[[Any], dict[str, float]]  # from a training state to the deterministic policy's figures


@dataclass(frozen=True)
class LoopOptions:
    """When to save and to evaluate; it does not change what is learnt."""

    checkpoint_minutes: Annotated[float, Range(0, 100_000)] = 5.0
    """Minutes between checkpoints; one is also written at each evaluation, at the end, and when stopped."""
    evaluations: Annotated[int, Range(0, 100_000)] = 10
    """Evaluations of the deterministic policy over the run, besides one at its start; 0 for none."""
    evaluation_episodes: COUNT = 8
    """Episodes of one such evaluation."""
    keep_every: TotalSteps | None = None
    """Samples between checkpoints that are kept for good; the last two and the best by evaluation always are."""

    def saves(self, samples: int, per_iteration: int, seconds: float) -> bool:
        """Whether to save at so many samples, seconds after the last time, were there no evaluation."""
        kept = retention.passes(samples, self.keep_every, per_iteration)
        return kept or seconds >= 60 * self.checkpoint_minutes

    def evaluates(self, done: int, iterations: int) -> bool:
        """Whether to evaluate after so many iterations of all: the first, then at even distances, then the last."""
        if not self.evaluations:
            return False
        every = max(1, round(iterations / self.evaluations))
        return done in (1, iterations) or done % every == 0
