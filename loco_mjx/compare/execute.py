"""Runs one cell of a sweep: its commands, one after the other, and what went wrong with them."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.die_with_parent import dying_with_parent
from loco_mjx.errors import UserError

POLL_SECONDS = 0.2
TICK_SECONDS = 10.0  # between looks at a run's curves
# From a command, the file its output is appended to, and what to call now and then: the exit code.
Runner = Callable[[list[str], Path, Callable[[], None]], int]


def run_command(command: list[str], log: Path, tick: Callable[[], None]) -> int:
    """Runs a command to its end. Ctrl-C stops it, lets it save, and is then raised here.

    It has a session of its own, so that a Ctrl-C reaches it once, from here.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as file:
        process = subprocess.Popen(
            dying_with_parent(command), stdout=file, stderr=subprocess.STDOUT, start_new_session=True
        )
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


def run_cell(cell: Cell, run: Runner, tick: Callable[[], None]) -> str | None:
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
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if log.is_file() else []
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last = lines[-1].strip() if lines else "it printed nothing"
    return f"{what}: {how}: {last} (all of it: {log})"
