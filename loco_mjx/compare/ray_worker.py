"""What a worker of a Ray cluster does with a cell of a sweep, once whoever had it before has let go of it."""

from __future__ import annotations

import fcntl
import signal
import socket
import threading
import time
from pathlib import Path

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.execute import Runner, run_cell
from loco_mjx.run.directory import LOCK

SAVE_SECONDS = 300.0  # for a run that was told to stop: it ends its iteration first


def work(cell: Cell, run: Runner) -> str | None:
    """Runs a cell in a worker; what went wrong, or None."""
    # Ray cancels by the handler of SIGINT, and a cluster that was started in a shell's background ignores that.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not cell.path.parent.is_dir():
        return f"{socket.gethostname()} does not see {cell.path.parent}; give an --out that all nodes share"
    _wait_while_claimed(cell.path / LOCK)
    return run_cell(cell, run, lambda: None)


def _wait_while_claimed(lock: Path) -> None:
    """Waits while a run whose worker died saves and ends."""
    end = time.monotonic() + SAVE_SECONDS
    while lock.is_file() and time.monotonic() < end:
        with lock.open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                time.sleep(1.0)
