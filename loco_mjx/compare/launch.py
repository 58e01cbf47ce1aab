"""Runs a sweep's cells on this machine, one after the other, each on all of its devices."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.estimate import overview, rates, say_time, seconds_left
from loco_mjx.errors import UserError
from loco_mjx.run.progress import Reporter

POLL_SECONDS = 0.2
TICK_SECONDS = 10.0  # between looks at a run's curves
# From a command, the file its output is appended to, and what to call now and then: the exit code.
Runner = Callable[[list[str], Path, Callable[[], None]], int]


@dataclass
class Result:
    """How a sweep ended.

    Attributes:
        ran: cells that were run and finished.
        skipped: cells that had been finished before.
        failed: cells that did not, and why.
    """

    ran: list[Cell] = field(default_factory=list)
    skipped: list[Cell] = field(default_factory=list)
    failed: list[tuple[Cell, str]] = field(default_factory=list)


def run_command(command: list[str], log: Path, tick: Callable[[], None]) -> int:
    """Runs a command to its end; Ctrl-C stops it, so that it saves, and is raised when it has.

    It has a session of its own, so that a Ctrl-C reaches it once, from here.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            last = time.monotonic()
            while process.poll() is None:
                time.sleep(POLL_SECONDS)
                if time.monotonic() - last >= TICK_SECONDS:
                    tick()
                    last = time.monotonic()
        except BaseException:
            with contextlib.suppress(KeyboardInterrupt):  # a second one: do not wait
                process.terminate()  # `train` saves on it; a SIGINT may be ignored, as it is below a shell's `&`
                process.wait()
            process.kill()
            raise
    return process.returncode


def split(cells: Sequence[Cell]) -> tuple[list[Cell], list[tuple[Cell, str]]]:
    """The cells that are finished, and those that cannot be run because of what lies in their directory."""
    finished, blocked = [], []
    for cell in cells:
        try:
            if cell.finished():
                finished.append(cell)
        except UserError as error:
            blocked.append((cell, str(error)))
    return finished, blocked


def sweep(cells: Sequence[Cell], console: Console, run: Runner = run_command, dry: bool = False) -> Result:
    """Shows what will run and how long, runs it, and says how it ended.

    Args:
        cells: to run, in this order.
        console: for the table, the progress and the failures.
        run: runs one command.
        dry: only show.

    Raises:
        UserError: if the directories of the runs cannot be made; nothing has run then.
    """
    if not dry:
        _make_directories(cells)
    finished, blocked = split(cells)
    console.print(overview(cells, finished))
    result = Result(skipped=finished, failed=blocked)
    todo = [cell for cell in cells if cell not in finished and cell not in [cell for cell, _ in blocked]]
    if not dry and todo:
        with _sigterm_as_interrupt(), _progress(console, cells) as progress:
            for i, cell in enumerate(todo):
                left = say_time(seconds_left(todo[i:], rates(cells)))
                progress.say(f"{cell.name}: {i + 1} of {len(todo)}; time left for training: {left}")
                progress.current = cell
                problem = _run_cell(cell, run, progress.tick)
                if problem is None:
                    result.ran.append(cell)
                else:
                    result.failed.append((cell, problem))
                    progress.say(f"failed: {cell.name}: {problem}")
    _conclude(result, console, dry, len(todo))
    return result


def _make_directories(cells: Sequence[Cell]) -> None:
    for folder in dict.fromkeys(cell.path.parent for cell in cells):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot write {folder}: {error.strerror or error}; choose another --out") from error


def _run_cell(cell: Cell, run: Runner, tick: Callable[[], None]) -> str | None:
    """Trains and evaluates a cell; what went wrong, or None."""
    try:
        if not cell.trained():
            code = run(cell.train_command(), cell.log, tick)
            if code:
                return _failure("train", code, cell.log)
        for task in cell.unevaluated():
            code = run(cell.evaluate_command(task), cell.log, tick)
            if code:
                return _failure(f"evaluate on {task}", code, cell.log)
        return None if cell.finished() else f"its commands ended well, but it is not finished; see {cell.log}"
    except (UserError, OSError) as error:
        return " ".join(str(error).split())


def _failure(what: str, code: int, log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.is_file() else []
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last = lines[-1].strip() if lines else "it printed nothing"
    return f"{what}: {how}: {last} (all of it: {log})"


def _conclude(result: Result, console: Console, dry: bool, todo: int) -> None:
    verb = f"{todo} to run" if dry else f"{len(result.ran)} run"
    text = f"{verb}, {len(result.skipped)} finished before, {len(result.failed)} failed"
    lines = [text, *(f"failed: {cell.name}: {problem}" for cell, problem in result.failed)]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


class _Progress:
    """Samples of the whole sweep."""

    def __init__(self, console: Console, cells: Sequence[Cell]) -> None:
        self._done = {cell.name: cell.done() for cell in cells}
        self._before = self._shown = sum(self._done.values())
        self._begin = time.monotonic()
        self.current = cells[0]
        self.reporter = Reporter(console, sum(cell.samples for cell in cells), self._before)

    def say(self, text: str) -> None:
        self.reporter.say(text)

    def tick(self) -> None:
        self._done[self.current.name] = self.current.done()
        done = sum(self._done.values())
        if done > self._shown:
            self._shown = done
            self.reporter.update(done, (done - self._before) / max(time.monotonic() - self._begin, 1e-3), {})


@contextlib.contextmanager
def _progress(console: Console, cells: Sequence[Cell]) -> Iterator[_Progress]:
    progress = _Progress(console, cells)
    try:
        yield progress
    finally:
        progress.reporter.close()


@contextlib.contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """SIGTERM saves and stops as Ctrl-C does; only the main thread may say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
