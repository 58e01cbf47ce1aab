"""A sweep: shows what will run and how long, has a launcher run it, says how it ended; and the local launcher."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from rich.console import Console

from loco_mjx.compare import methods
from loco_mjx.compare.cells import Cell
from loco_mjx.compare.estimate import overview
from loco_mjx.compare.execute import Runner, run_cell, run_command
from loco_mjx.compare.progress import Progress, shown
from loco_mjx.errors import UserError
from loco_mjx.run.results import Run

Ended = Callable[[Cell, str | None], None]  # takes a cell that has ended, and what went wrong, or None


class Launcher(Protocol):
    """Where cells run."""

    def ready(self) -> contextlib.AbstractContextManager[None]:
        """A context in which cells can run, such as a connection to a cluster.

        Raises:
            UserError: if it cannot; nothing has been written then.
        """

    def launch(self, cells: Sequence[Cell], progress: Progress, ended: Ended) -> None:
        """Runs cells, and calls `ended` with each; Ctrl-C stops them, lets them save, and is then raised here."""


@dataclass(frozen=True)
class Local:
    """This machine: one cell after the other, each on all of its devices.

    Attributes:
        run: runs one command.
    """

    run: Runner = run_command

    def ready(self) -> contextlib.AbstractContextManager[None]:
        """Nothing is needed."""
        return contextlib.nullcontext()

    def launch(self, cells: Sequence[Cell], progress: Progress, ended: Ended) -> None:
        """Runs cells in their order."""
        for i, cell in enumerate(cells):
            left = progress.time_left(cells[i:])
            progress.say(f"{cell.name}: {i + 1} of {len(cells)}; time left: {left}")
            ended(cell, run_cell(cell, self.run, partial(progress.tick, [cell])))


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


def sweep(cells: Sequence[Cell], console: Console, launcher: Launcher | None = None, dry: bool = False) -> Result:
    """Shows what will run and how long, runs it, shows what was measured, and says how it ended.

    Args:
        cells: to run, in this order.
        console: for the table, the progress and the failures.
        launcher: where to run them; None: on this machine.
        dry: only show.

    Raises:
        UserError: if the launcher cannot run or the directories of the runs cannot be made; nothing has run then.
    """
    launcher = launcher or Local()
    finished, blocked = split(cells)
    result = Result(skipped=finished, failed=blocked)
    todo = [cell for cell in cells if cell not in finished and cell not in [cell for cell, _ in blocked]]
    with contextlib.nullcontext() if dry or not todo else launcher.ready():
        if not dry:
            _make_directories(cells)
        console.print(overview(cells, finished))
        if todo and not dry:
            _launch(launcher, cells, todo, console, result)
    if not dry and (result.ran or result.skipped):
        _show(result.skipped + result.ran, console)
    _conclude(result, console, dry, len(todo))
    return result


def _show(cells: Sequence[Cell], console: Console) -> None:
    """What was measured of the cells that are finished."""
    try:
        console.print(methods.overview(methods.of_runs([Run.of(cell.path, cell.config) for cell in cells])))
    except UserError as error:  # the runs are finished all the same
        console.print(f"no summary: {error}", markup=False, highlight=False, soft_wrap=True)


def _launch(launcher: Launcher, cells: Sequence[Cell], todo: list[Cell], console: Console, result: Result) -> None:
    """Runs what there is to do, and sorts it into what ran and what failed."""
    with _sigterm_as_interrupt(), shown(console, cells) as progress:

        def ended(cell: Cell, problem: str | None) -> None:
            progress.tick([cell])
            if problem is None:
                result.ran.append(cell)
            else:
                result.failed.append((cell, problem))
                progress.say(f"failed: {cell.name}: {problem}")

        launcher.launch(todo, progress, ended)


def _make_directories(cells: Sequence[Cell]) -> None:
    for folder in dict.fromkeys(cell.path.parent for cell in cells):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot write {folder}: {error.strerror or error}; choose another --out") from error


def _conclude(result: Result, console: Console, dry: bool, todo: int) -> None:
    verb = f"{todo} to run" if dry else f"{len(result.ran)} run"
    text = f"{verb}, {len(result.skipped)} finished before, {len(result.failed)} failed"
    lines = [text, *(f"failed: {cell.name}: {problem}" for cell, problem in result.failed)]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


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
