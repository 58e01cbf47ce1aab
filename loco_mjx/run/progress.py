"""What a run shows while it trains: a live line on a terminal, plain lines every few seconds elsewhere."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Callable, Iterator, Mapping

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
    """A duration in a readable unit: 42 s, 7 min, 2.8 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Output(Console):
    """A console whose reader may leave: to print then raises BrokenPipeError, where others would end the process."""

    def on_broken_pipe(self) -> None:
        """What rich calls."""
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


class Reporter:
    """Shows samples, samples per second, time left, return, distance and KL.

    It goes on in silence when nothing can be printed any more, and `lost` then says why. Episode figures are of the
    last iteration in which an episode ended. What is left takes as long, per sample, as what came after the first
    iteration: that one holds the compilation. Evaluations and checkpoints are counted in.
    """

    def __init__(
        self,
        console: Console,
        total: int,
        done: int,
        clock: Callable[[], float] = time.monotonic,
        callback: Callable[[int, Mapping[str, float]], object] | None = None,
    ) -> None:
        """Starts at `done` of `total` samples.

        Args:
            console: to print on.
            total: samples.
            done: of them.
            clock: gives seconds.
            callback: called with every iteration's samples and metrics; once it returns True, `asked_to_stop` is set.
        """
        self._callback, self.asked_to_stop = callback, False
        self._console, self._total, self._clock = console, total, clock
        self._rate: float | None = None
        self._first: tuple[int, float] | None = None  # samples after the first iteration, and when
        self._figures: dict[str, float] = {}
        self._last_line = -float("inf")
        self._progress: Progress | None = None
        self.lost: OSError | None = None
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

    def update(
        self, done: int, samples_per_second: float, metrics: Mapping[str, float], left: float | None = None
    ) -> None:
        """Takes in an iteration.

        Args:
            done: samples so far.
            samples_per_second: of the iteration; the first one's is not shown, since it holds the compilation.
            metrics: of the iteration.
            left: seconds that what is left takes; None: as this display has it.
        """
        if self._callback is not None and self._callback(done, dict(metrics)) is True:
            self.asked_to_stop = True
        now = self._clock()
        if self._first is None:
            self._first = (done, now)
        else:
            old = samples_per_second if self._rate is None else self._rate
            self._rate = (1 - _SMOOTH) * old + _SMOOTH * samples_per_second
        if left is None:
            left = self._seconds_left(done, now - self._first[1])
        self._figures |= metrics
        text = self._text(left)
        with self._noting_loss():
            if self._progress is not None:
                self._progress.update(self._task, completed=done, description=text)
            elif now - self._last_line >= LINE_SECONDS or done >= self._total:
                self._last_line = now
                self._plain(f"{done:,}/{self._total:,} samples  {text}")

    def say(self, text: str) -> None:
        """Prints a line beside the progress."""
        with self._noting_loss():
            if self._progress is not None:
                self._progress.console.print(text, markup=False, highlight=False)
            else:
                self._plain(text)

    def close(self) -> None:
        """Ends the live display."""
        if self._progress is not None:
            with self._noting_loss():
                self._progress.stop()

    @contextlib.contextmanager
    def _noting_loss(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.lost = error

    def _plain(self, text: str) -> None:
        if self.lost is None:
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _seconds_left(self, done: int, seconds: float) -> float | None:
        """What is left, from the seconds since the first iteration; None after that one."""
        since = done - self._first[0] if self._first else 0
        if done >= self._total:
            return 0.0
        return (self._total - done) * seconds / since if since else None

    def _text(self, left: float | None) -> str:
        parts = [] if self._rate is None else [f"{self._rate:,.0f} samples/s"]
        parts.append("estimating the time left" if left is None else f"{duration(left)} left")
        parts += [f"{name} {form.format(self._figures[key])}" for name, key, form in FIGURES if key in self._figures]
        return "  ".join(parts)
