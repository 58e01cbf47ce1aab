"""The progress of a whole sweep: samples of all its cells, as their curves have them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence

from rich.console import Console

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.estimate import rates, say_time, seconds_left
from loco_mjx.run.progress import Reporter


class Progress:
    """Samples of the whole sweep."""

    def __init__(self, console: Console, cells: Sequence[Cell]) -> None:
        """Starts at what the cells have been trained on so far."""
        self._cells = cells
        self._done = {cell.name: cell.done() for cell in cells}
        self._before = self._shown = sum(self._done.values())
        self._begin = time.monotonic()
        self._reporter = Reporter(console, sum(cell.samples for cell in cells), self._before)

    def say(self, text: str) -> None:
        """Prints a line beside the progress."""
        self._reporter.say(text)

    def time_left(self, cells: Sequence[Cell], at_once: int = 1) -> str:
        """How long some cells will train yet, so many of them at once."""
        seconds = seconds_left(cells, rates(self._cells))
        return say_time(None if seconds is None else seconds / at_once)

    def tick(self, running: Sequence[Cell]) -> None:
        """Looks at the curves of the cells that run, and shows what has changed."""
        self._done |= {cell.name: cell.done() for cell in running}
        done = sum(self._done.values())
        if done > self._shown:
            self._shown = done
            self._reporter.update(done, (done - self._before) / max(time.monotonic() - self._begin, 1e-3), {})

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
