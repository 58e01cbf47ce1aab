"""What a run shows while it trains: a live line on a terminal, plain lines every few seconds elsewhere."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

LINE_SECONDS = 5.0  # between plain lines
_SMOOTH = 0.3  # weight of the newest iteration in the shown rate
# Name shown, metric, format.
FIGURES = (
    ("return", "episode/return", "{:.1f}"),
    ("distance", "episode/distance", "{:.2f} m"),
    ("length", "episode/length", "{:.0f}"),
    ("KL", "policy/approx_kl", "{:.4f}"),
)


def duration(seconds: float) -> str:
    """Seconds as people say them: 42 s, 7 min, 2.8 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Reporter:
    """Shows samples, samples per second, time left, return, distance and KL.

    Episode figures are of the last iteration in which an episode ended.
    """

    def __init__(self, console: Console, total: int, done: int) -> None:
        """Starts at `done` of `total` samples."""
        self._console, self._total, self._done = console, total, done
        self._rate = 0.0
        self._iterations = 0
        self._figures: dict[str, float] = {}
        self._last_line = -float("inf")
        self._progress: Progress | None = None
        if console.is_terminal:
            columns = (
                BarColumn(bar_width=12),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.description}"),
            )
            self._progress = Progress(*columns, console=console)
            self._task = self._progress.add_task("compiling", total=total, completed=done)
            self._progress.start()

    def update(self, done: int, samples_per_second: float, metrics: Mapping[str, float]) -> None:
        """Takes in an iteration. The first one's rate is forgotten by the second: it holds the compilation."""
        self._done = done
        self._iterations += 1
        old = samples_per_second if self._iterations <= 2 else self._rate
        self._rate = (1 - _SMOOTH) * old + _SMOOTH * samples_per_second
        self._figures |= metrics
        if self._progress is not None:
            self._progress.update(self._task, completed=done, description=self._text())
        elif time.monotonic() - self._last_line >= LINE_SECONDS or done >= self._total:
            self._last_line = time.monotonic()
            self._plain(f"{done:,}/{self._total:,} samples  {self._text()}")

    def say(self, text: str) -> None:
        """Prints a line beside the progress."""
        if self._progress is not None:
            self._progress.console.print(text, markup=False, highlight=False)
        else:
            self._plain(text)

    def close(self) -> None:
        """Ends the live display."""
        if self._progress is not None:
            self._progress.stop()

    def _plain(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _text(self) -> str:
        left = duration((self._total - self._done) / self._rate)
        parts = [f"{self._rate:,.0f} samples/s", f"{left} left"]
        parts += [f"{name} {form.format(self._figures[key])}" for name, key, form in FIGURES if key in self._figures]
        return "  ".join(parts)
