"""The training loop around one compiled iteration: resume, iterate, log, evaluate, save, stop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import jax

from loco_mjx.config import Config
from loco_mjx.errors import UserError
from loco_mjx.run import checkpoint, machine
from loco_mjx.run.logger import SECONDS, Logger
from loco_mjx.run.progress import Reporter
from loco_mjx.run.stop import Stop

Evaluate = Callable[[Any], dict[str, float]]  # from a training state to the deterministic policy's figures


class Learner(Protocol):
    """What the loop needs of :class:`loco_mjx.ppo.train.Trainer`."""

    def init(self) -> Any:
        """The state before the first iteration."""

    def make_pool(self, iteration: int) -> Any:
        """The scenes of an iteration."""

    def iterate(self, state: Any, pool: Any) -> tuple[Any, dict[str, jax.Array]]:
        """One iteration: the next state and scalars."""


@dataclass(frozen=True)
class LoopOptions:
    """When to save and to evaluate; none of it changes what is learnt."""

    checkpoint_minutes: float = 5.0
    """Minutes between checkpoints; one is also written at the end, and when stopped."""
    evaluations: int = 10
    """Evaluations of the deterministic policy over the run, besides one at its start; 0 for none."""
    evaluation_episodes: int = 8
    """Episodes of one such evaluation."""


@dataclass(frozen=True)
class Outcome:
    """How a loop ended.

    Attributes:
        samples: trained in all.
        signal: the signal that stopped it, or None if it is finished.
    """

    samples: int
    signal: int | None = None


def run(
    learner: Learner,
    config: Config,
    directory: Path,
    options: LoopOptions,
    reporter: Reporter,
    evaluate: Evaluate | None = None,
) -> Outcome:
    """Trains until `total_steps`, from the newest checkpoint of the directory if there is one.

    The directory is claimed, and its configuration written, by the caller.

    Raises:
        UserError: if its checkpoints cannot be used or the disk cannot be written.
    """
    with Stop(reporter.say) as stop:
        state, samples = _begin(learner, config, directory, reporter)
        logger = Logger(directory, samples)
        try:
            return _Loop(learner, config, directory, options, reporter, evaluate, logger, stop).run(state, samples)
        finally:
            logger.close()


def _begin(learner: Learner, config: Config, directory: Path, reporter: Reporter) -> tuple[Any, int]:
    state = learner.init()
    restored = checkpoint.restore(directory, state, config, reporter.say)
    if restored is None:
        return state, 0
    reporter.say(f"resuming at {restored[1]:,} samples")
    return restored


def policy_of(state: Any) -> checkpoint.Policy:
    """The part of a training state that acts."""
    return {"params": state.params, "normalizer": state.normalizer}


class _Loop:
    def __init__(
        self,
        learner: Learner,
        config: Config,
        directory: Path,
        options: LoopOptions,
        reporter: Reporter,
        evaluate: Evaluate | None,
        logger: Logger,
        stop: Stop,
    ) -> None:
        self.learner, self.config, self.directory, self.options = learner, config, directory, options
        self.reporter, self.evaluate, self.logger, self.stop = reporter, evaluate, logger, stop
        self.per_iteration = config.ppo.samples_per_iteration
        self.spent = logger.seconds  # over all starts
        self.warned = False

    def run(self, state: Any, samples: int) -> Outcome:
        saved, saved_at = samples, time.monotonic()
        iteration = samples // self.per_iteration
        pool = None
        first = iteration
        while iteration < self.config.ppo.iterations and self.stop.signal is None:
            if pool is None or iteration % self.config.ppo.pool_refresh == 0:
                pool = self.learner.make_pool(iteration)
            state = self._iterate(state, pool, iteration)
            iteration += 1
            self._say_age(iteration - first)
            samples = iteration * self.per_iteration
            if time.monotonic() - saved_at >= 60 * self.options.checkpoint_minutes:
                self._save(state, samples)
                saved, saved_at = samples, time.monotonic()
        if samples != saved:
            self._save(state, samples)
        return Outcome(samples, self.stop.signal)

    def _iterate(self, state: Any, pool: Any, iteration: int) -> Any:
        start = time.monotonic()
        state, metrics = self.learner.iterate(state, pool)
        row = {name: float(value) for name, value in jax.device_get(metrics).items()}
        seconds = time.monotonic() - start
        self._refuse_divergence(row, iteration * self.per_iteration)
        if row.get("episodes") == 0:  # means over no episodes are not zero, they are not there
            row = {name: value for name, value in row.items() if not name.startswith("episode/")}
        rate = self.per_iteration / seconds
        if self._due(iteration + 1):
            assert self.evaluate is not None
            row |= {f"eval/{name}": value for name, value in self.evaluate(state).items()}
        self.spent += time.monotonic() - start
        samples = (iteration + 1) * self.per_iteration
        self.logger.write(samples, row | {SECONDS: self.spent, "time/samples_per_second": rate})
        self.reporter.update(samples, rate, row)
        return state

    def _say_age(self, done: int) -> None:
        age = machine.process_age() if done == 1 else None
        if age is not None:
            self.reporter.say(f"first iteration done {age:.0f} s after the command")

    def _refuse_divergence(self, row: dict[str, float], samples: int) -> None:
        """Ends a run whose loss is no number before a checkpoint keeps it; whose environments broke are told of."""
        broken = [name for name, value in row.items() if name.startswith("loss/") and not math.isfinite(value)]
        if broken:
            raise UserError(
                f"training diverged after {samples:,} samples ({broken[0]} is {row[broken[0]]}); "
                f"{self.directory} keeps the last checkpoint: lower ppo.learning-rate and use another --out"
            )
        if row.get("nonfinite") and not self.warned:
            self.warned = True
            self.reporter.say(f"{row['nonfinite']:.0f} non-finite states were contained; metrics.csv counts them")

    def _due(self, done: int) -> bool:
        """Whether to evaluate after this many iterations: the first, then at even distances, then the last."""
        if self.evaluate is None or not self.options.evaluations:
            return False
        every = max(1, round(self.config.ppo.iterations / self.options.evaluations))
        return done in (1, self.config.ppo.iterations) or done % every == 0

    def _save(self, state: Any, samples: int) -> None:
        checkpoint.save(self.directory, samples, state, policy_of(state), self.config)
