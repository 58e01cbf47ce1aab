"""The progress of a whole sweep: samples of all its cells, as their curves have them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence

from rich.console import Console

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.estimate import Paces, paces, say_time, seconds_left
from loco_mjx.run.progress import Reporter


class Progress:
    """Samples of the whole sweep, teachers' included."""

    def __init__(self, console: Console, cells: Sequence[Cell]) -> None:
        """Starts at what the cells have been trained on so far."""
        self._cells = cells
        self._done = {cell.name: cell.done() for cell in cells}
        self._taught = {cell.name: cell.teacher_done() for cell in cells}
        self._start = dict(self._done)
        self._before = self._shown = self._samples()
        self._begin = time.monotonic()
        self._paces: Paces = paces(cells)
        self._left, self._at_once = list(cells), 1
        self._reporter = Reporter(console, sum(cell.samples + cell.teacher_samples for cell in cells), self._before)

    def say(self, text: str) -> None:
        """Prints a line beside the progress."""
        self._reporter.say(text)

    def time_left(self, cells: Sequence[Cell], at_once: int = 1) -> str:
        """How long some cells will take yet, so many of them at once."""
        self._paces, self._left, self._at_once = paces(self._cells), list(cells), at_once
        return say_time(self._seconds_left())

    def tick(self, running: Sequence[Cell]) -> None:
        """Looks at the curves of the cells that run, and shows what has changed."""
        self._done |= {cell.name: cell.done() for cell in running}
        self._taught |= {cell.name: cell.teacher_done() for cell in running}
        done = self._samples()
        if done > self._shown:
            self._shown = done
            rate = (done - self._before) / max(time.monotonic() - self._begin, 1e-3)
            self._reporter.update(done, rate, {}, left=self._seconds_left())

    def _samples(self) -> int:
        """Trained on so far, in all."""
        return sum(self._done.values()) + sum(self._taught.values())

    def _seconds_left(self) -> float | None:
        """Of the cells that were last asked for, since when some may have been trained on."""
        begun = {name for name, samples in self._done.items() if samples > self._start[name]}
        seconds = seconds_left(self._left, self._paces, self._done, begun)
        return None if seconds is None else seconds / min(self._at_once, len(self._left) or 1)

    def close(self) -> None:
        """Ends the live display."""
        self._reporter.close()


@contextlib.contextmanager
def shown(console: Console, cells: Sequence[Cell]) -> Iterator[Progress]:
    """A progress while a sweep runs."""
    progress = Progress(console, cells)
    try:
        yield progress
    finally:
        progress.close()
