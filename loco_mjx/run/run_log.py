"""What one run writes into its directory while it trains: rows of its curves, and checkpoints."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loco_mjx.config import Config
from loco_mjx.errors import RunError, UserError
from loco_mjx.run import checkpoint, collectives
from loco_mjx.run.directory import CONFIG, LOCK
from loco_mjx.run.logger import Logger
from loco_mjx.run.rows import Row

SCORE = "eval/return"  # by which the best checkpoint is chosen
NONFINITE = "nonfinite/"  # the learner's metrics of how many numbers of its state are NaN or infinite


@dataclass(frozen=True)
class Run:
    """A run and where it lies."""

    config: Config
    directory: Path


class RunLog:
    """Writes a run's curves and checkpoints; of several processes the first one writes.

    Attributes:
        run: whose.
        problem: why it cannot go on, or None.
        failure: what kept its curves from being written, or None.
    """

    def __init__(self, run: Run, samples: int, say: Callable[[str], None] = lambda text: None) -> None:
        """Reads the curves up to the step the run starts or resumes from; nothing is written before it is entered.

        Raises:
            UserError: if they cannot be read.
        """
        self.run, self.problem, self.failure = run, None, None
        self._logger = None
        if collectives.is_first():
            kept = checkpoint.curves(run.directory, samples) if samples else None
            self._logger = Logger(run.directory, samples, kept, say)

    problem: str | None
    failure: UserError | None
    _logger: Logger | None

    @property
    def seconds(self) -> float:
        """Time trained so far, over all starts."""
        return self._logger.seconds if self._logger else 0.0

    def write(self, samples: int, row: Row) -> None:
        """Appends a row to the curves; where they cannot be written, `failure` says so."""
        if self._logger is None:
            return
        try:
            self._check_place()
            self._logger.write(samples, row)
        except UserError as error:
            self.failure = error

    def save(self, samples: int, state: Any, keep_every: int | None = None) -> None:
        """Writes a checkpoint of the whole state, wherever its parts lie; every process is to call it.

        Args:
            samples: trained so far.
            state: the training state.
            keep_every: samples between checkpoints that are kept for good; None: none is.

        Raises:
            UserError: if the disk is full or not writable, or the run's directory has gone.
        """
        state = collectives.fetch_whole(state)
        if self._logger is not None:
            self._check_place()
            policy, curves = policy_of(state), self._logger.text
            score = self._logger.value(samples, SCORE)
            checkpoint.save(self.run.directory, samples, state, policy, self.run.config, curves, score, keep_every)

    def __enter__(self) -> RunLog:
        """Opens the files.

        Raises:
            UserError: without write access.
        """
        self._place = _identities(self.run.directory)
        if self._logger is not None:
            self._logger.open()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Closes the files.

        Raises:
            UserError: if the disk is full, unless an error is on its way already.
        """
        if self._logger is not None:
            self._logger.close(quietly=kind is not None)

    def in_place(self) -> bool:
        """Whether the run's directory is where it was; one that is being removed loses its files one by one."""
        return _identities(self.run.directory) == self._place

    def _check_place(self) -> None:
        if not self.in_place():
            raise RunError(f"{self.run.directory} has been removed or moved while it trained, so the run has ended")

    def check(self, row: Row, samples: int) -> bool:
        """Whether the run may go on: not if its losses or its state hold NaN or infinities, which would be saved."""
        broken = _diverged(row)
        if broken and self.problem is None:
            self.problem = (
                f"training diverged after {samples:,} samples ({broken}); "
                f"{self.run.directory} keeps the last checkpoint: lower ppo.learning-rate and use another --out"
            )
        return self.problem is None


def _diverged(row: Row) -> str | None:
    """What of an iteration's row shows that training has diverged."""
    for name, value in row.items():
        if name.startswith(NONFINITE) and value:
            return f"{value:,.0f} numbers of the {name.removeprefix(NONFINITE)} are NaN or infinite"
    for name, value in row.items():
        if name.startswith("loss/") and not math.isfinite(value):
            skipped = row.get("skipped_updates", 0.0)
            return f"all {skipped:,.0f} updates of an iteration were skipped" if skipped else f"{name} is {value}"
    return None


def _identities(directory: Path) -> list[tuple[int, int] | bool]:
    """What identifies a run's directory, so that another one in its place is noticed."""
    found: list[tuple[int, int] | bool] = [(directory / CONFIG).exists()]  # which an editor may replace
    for path in (directory, directory / LOCK):
        try:
            status = path.stat()
        except OSError:
            found.append(False)
        else:
            found.append((status.st_dev, status.st_ino))
    return found


def policy_of(state: Any) -> checkpoint.Policy:
    """The part of a training state that acts."""
    return {"params": state.policy, "normalizer": state.normalizer}


def common_step(runs: Sequence[Run], say: Callable[[str], None] = lambda text: None) -> int:
    """The newest step at which all runs have an undamaged checkpoint; 0 if none has trained.

    Args:
        runs: to be trained together.
        say: told of damaged checkpoints that were passed over.

    Raises:
        UserError: if there is none, naming what is damaged, or where each run stands.
    """
    if len(runs) == 1:  # it may go on from any of its own; restoring reports what is damaged
        return checkpoint.newest(runs[0].directory)
    problems: list[str] = []
    stand = {run.directory: checkpoint.whole_steps(run.directory, problems.append) for run in runs}
    if not problems and not any(max(steps, default=0) for steps in stand.values()):
        return 0
    shared = set.intersection(*(set(steps) for steps in stand.values()))
    if shared:
        for problem in problems:
            say(problem)
        return max(shared)
    newest = ", ".join(f"{path.name} at {max(steps, default=0):,}" for path, steps in stand.items())
    raise UserError(
        "; ".join(
            [*problems, f"the seeds in {runs[0].directory.parent} have no whole checkpoint at the same number of"]
        )
        + f" samples ({newest}); train those that lag behind by themselves (--seed, or a --seeds of those that stand "
        "together), or use another --out"
    )
