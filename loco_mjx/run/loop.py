"""The training loop around one compiled iteration: resume, iterate, log, evaluate, save, stop."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from signal import SIGINT, SIGPIPE
from typing import Any, NoReturn

import jax

from loco_mjx.config import Config
from loco_mjx.errors import UserError, is_full, unwritable
from loco_mjx.run import checkpoint, collectives, machine, rows
from loco_mjx.run.learner import GroupLearner, Learner, Single
from loco_mjx.run.logger import SECONDS
from loco_mjx.run.progress import Reporter
from loco_mjx.run.rows import Row
from loco_mjx.run.run_log import Run, RunLog, common_step
from loco_mjx.run.schedule import Evaluate, LoopOptions
from loco_mjx.run.signals import Leave, Stop


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
    """Trains one run until `total_steps`, from the newest checkpoint of the directory if there is one.

    The directory is claimed, and its configuration written, by the caller.

    Raises:
        UserError: if its checkpoints cannot be used or the disk cannot be written.
    """
    evaluations = [] if evaluate is None else [evaluate]
    return run_group(Single(learner), [Run(config, directory)], options, reporter, evaluations)


def run_group(
    learner: GroupLearner,
    runs: Sequence[Run],
    options: LoopOptions,
    reporter: Reporter,
    evaluations: Sequence[Evaluate],
    starting: Callable[[], None] = lambda: None,
) -> Outcome:
    """Trains runs side by side, from the newest step that all of them have a checkpoint of.

    A run that diverges leaves its last checkpoint and is no longer written; the others go on.

    Args:
        learner: of all of them.
        runs: in the learner's order; they differ in seed alone.
        options: when to save and to evaluate.
        reporter: shows all runs' samples together, and means over the runs.
        evaluations: one for each run, or none.
        starting: called when everything is read that may be refused, before anything is written.

    Raises:
        UserError: if their checkpoints cannot be used or the disk cannot be written; at the end, if one diverged.
    """
    samples = 0
    alone = jax.process_count() == 1  # one of several processes may not leave: the others would wait for it
    with Stop(reporter.say, alone, reporter.close) as stop, contextlib.ExitStack() as files:
        try:
            state, samples = _resume(learner, runs, reporter)
            logs = [RunLog(run, samples, reporter.say) for run in runs]
            starting()
            for log in logs:
                files.enter_context(log)
            return _Loop(learner, logs, options, reporter, evaluations, stop).run(state, samples)
        except Leave:
            return Outcome(samples, stop.signal)


def _resume(learner: GroupLearner, runs: Sequence[Run], reporter: Reporter) -> tuple[Any, int]:
    at = None if len(runs) == 1 else common_step(runs, reporter.say)
    state = learner.init()
    if at == 0:
        return state, 0
    found = [
        checkpoint.restore(run.directory, part, run.config, reporter.say, at=at)
        for run, part in zip(runs, learner.split(state), strict=True)
    ]
    samples = found[0][1] if found[0] else 0
    if len(set(collectives.allgather(samples // runs[0].config.ppo.samples_per_iteration).tolist())) > 1:
        raise UserError(f"processes see different checkpoints in {runs[0].directory}; a shared file system is needed")
    parts = [restored[0] for restored in found if restored is not None]
    if not parts:
        return state, 0
    if at is not None and collectives.is_first():
        for run in runs:
            checkpoint.drop_after(run.directory, at)
    reporter.say(f"resuming at {samples:,} samples")
    return learner.join(parts), samples


class _Loop:
    def __init__(
        self,
        learner: GroupLearner,
        logs: Sequence[RunLog],
        options: LoopOptions,
        reporter: Reporter,
        evaluations: Sequence[Evaluate],
        stop: Stop,
    ) -> None:
        self.learner, self.logs, self.options = learner, logs, options
        self.reporter, self.evaluations, self.stop = reporter, evaluations, stop
        self.ppo = logs[0].run.config.ppo
        self.per_iteration = self.ppo.samples_per_iteration  # of one run
        self.spent = logs[0].seconds  # over all starts
        self.warned = False

    def run(self, state: Any, samples: int) -> Outcome:
        saved, saved_at = samples, time.monotonic()
        iteration = first = samples // self.per_iteration
        pool = None
        if samples == 0 and len(self.logs) > 1:  # where all stand together if a kill meets the first checkpoints
            self._save(state, 0)
        _, signal, failed = collectives.agreed(False, self._signal())
        while iteration < self.ppo.iterations and signal is None and not failed:
            if pool is None or iteration % self.ppo.pool_refresh == 0:
                pool = self.learner.make_pool(iteration)
            state = self._iterate(state, pool, iteration)
            self.stop.can_leave = False
            iteration += 1
            self._say_age(iteration - first)
            samples = iteration * self.per_iteration
            time_to_save = self._time_to_save(iteration, time.monotonic() - saved_at)
            time_to_save, signal, failed = collectives.agreed(time_to_save, self._signal(), self._failure() is not None)
            if time_to_save and not failed:
                self._save(state, samples)
                saved, saved_at = samples, time.monotonic()
        if failed:
            self._give_up(state, samples, saved)
        if samples != saved:
            self._save(state, samples)
        self._tell_of_problems()
        return Outcome(samples, signal)

    def _iterate(self, state: Any, pool: Any, iteration: int) -> Any:
        start = time.monotonic()
        state, metrics = self.learner.iterate(state, pool)
        found = rows.of_runs(jax.device_get(metrics), len(self.logs))
        seconds = time.monotonic() - start
        samples = (iteration + 1) * self.per_iteration
        self._refuse_divergence(found, iteration * self.per_iteration)
        rate = self.per_iteration / seconds
        if self._time_to_evaluate(iteration + 1):
            for row, evaluate, part in zip(found, self.evaluations, self.learner.split(state), strict=True):
                row |= {f"eval/{name}": value for name, value in evaluate(part).items()}
        self.spent += time.monotonic() - start
        going = [(log, row) for log, row in zip(self.logs, found, strict=True) if log.problem is None]
        for log, row in going:
            log.write(samples, row | {SECONDS: self.spent, "time/samples_per_second": rate})
        count = len(self.logs)
        self.reporter.update(samples * count, rate * count, rows.means([row for _, row in going]))
        return state

    def _say_age(self, done: int) -> None:
        age = machine.process_age() if done == 1 else None
        if age is not None:
            self.reporter.say(f"first iteration done {age:.0f} s after the command")

    def _refuse_divergence(self, found: Sequence[Row], samples: int) -> None:
        """Ends runs whose loss is not finite, before a checkpoint keeps that; warns of environments that broke."""
        for log, row in zip(self.logs, found, strict=True):
            if log.problem is None and not log.check(row, samples) and len(self.logs) > 1:
                self.reporter.say(f"{log.problem}; the other seeds go on")
        if all(log.problem for log in self.logs):
            self._tell_of_problems()
        going = [row for log, row in zip(self.logs, found, strict=True) if log.problem is None]
        if skipped := sum(row.get("skipped_updates", 0.0) for row in going):
            self.reporter.say(f"{skipped:.0f} updates were skipped after {samples:,} samples: no finite gradient")
        broken = sum(row.get("nonfinite", 0.0) for row in found)
        if broken and not self.warned:
            self.warned = True
            self.reporter.say(f"{broken:.0f} non-finite states were contained; metrics.csv counts them")

    def _tell_of_problems(self) -> None:
        if problems := [log.problem for log in self.logs if log.problem is not None]:
            raise UserError("; ".join(problems))

    def _time_to_save(self, done: int, seconds: float) -> bool:
        """Whether to save after this many iterations, seconds after the last time."""
        return self.options.saves(done * self.per_iteration, self.per_iteration, seconds) or self._time_to_evaluate(
            done
        )

    def _time_to_evaluate(self, done: int) -> bool:
        return bool(self.evaluations) and self.options.evaluates(done, self.ppo.iterations)

    def _signal(self) -> int | None:
        """The signal that came; a reader of the output who leaves counts as one, and whoever asked the reporter."""
        if self.stop.signal or self.reporter.lost is not None:
            return self.stop.signal or SIGPIPE
        return SIGINT if self.reporter.asked_to_stop else None

    def _failure(self) -> UserError | None:
        lost = self.reporter.lost
        if lost is not None and is_full(lost):
            return unwritable("what is printed", lost, "")
        return next((log.failure for log in self.logs if log.failure is not None), None)

    def _give_up(self, state: Any, samples: int, saved: int) -> NoReturn:
        """Ends a run whose curves cannot be written, with a checkpoint if that can be."""
        failure = self._failure() or UserError("the first process cannot write; its own last line says why")
        if not all(log.in_place() for log in self.logs):
            with contextlib.suppress(UserError):  # those of seeds whose directories are there
                self._save(state, samples)
            raise failure
        kept = f"the checkpoint at {saved:,} samples is kept" if saved else "there is no checkpoint yet"
        try:
            self._save(state, samples)
        except UserError:
            raise type(failure)(f"{failure}; {kept}") from failure
        raise type(failure)(f"{failure}; saved at {samples:,} samples") from failure

    def _save(self, state: Any, samples: int) -> None:
        """Writes all runs' checkpoints; if one cannot be written, the others still are."""
        problems: list[UserError] = []
        for log, part in zip(self.logs, self.learner.split(state), strict=True):
            if log.problem is None:
                try:
                    log.save(samples, part, self.options.keep_every)
                except UserError as error:
                    problems.append(error)
        if problems:
            raise problems[0]
