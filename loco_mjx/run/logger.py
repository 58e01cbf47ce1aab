"""The curves of a run: `metrics.csv` and TensorBoard, without repeated steps after a resumption."""

from __future__ import annotations

import contextlib
import csv
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TextIO

from loco_mjx.errors import unwritable
from loco_mjx.run import metrics_csv as rows_lib
from loco_mjx.run.directory import PARTIAL, open_new
from loco_mjx.run.metrics_csv import STEP, Rows
from loco_mjx.run.metrics_csv import read as read_rows
from loco_mjx.run.tensorboard import Events

__all__ = ["CSV", "SECONDS", "STEP", "TENSORBOARD", "Logger", "read_rows"]

CSV, TENSORBOARD, SECONDS = "metrics.csv", "tensorboard", "time/seconds"
CHANGED = ".changed"  # added to the name of a file that was not as it had been written


class Logger:
    """Writes one row per iteration.

    Columns appear when a metric first does; rows without it leave it empty. Rows beyond the step resumed from are
    dropped, from both the file and the curves, since they are about to be made again. Nothing is written before the
    first row, or `open`.
    """

    def __init__(
        self, directory: Path, step: int, kept: str | None = None, say: Callable[[str], None] = lambda text: None
    ) -> None:
        """Reads the curves of a run up to the step it starts or resumes from.

        Args:
            directory: the run's.
            step: samples trained so far.
            kept: the file as it was at that step; None: nobody knows.
            say: told if the file is not as it was.

        Raises:
            UserError: if they cannot be read.
        """
        self._path, self._step, self._say = directory / CSV, step, say
        self._columns: list[str] = []
        self._file: TextIO | None = None
        self._events: Events | None = None
        with self._writing():
            self._rows, self._problem = _recovered(self._path, step, kept)

    @property
    def seconds(self) -> float:
        """Time trained so far, over all starts, as the last row has it."""
        return float(self._rows[-1].get(SECONDS) or 0.0) if self._rows else 0.0

    @property
    def text(self) -> str:
        """What the file holds, or is to hold."""
        return rows_lib.text_of(self._rows, self._columns)

    def value(self, step: int, name: str) -> float | None:
        """A metric of the last row, if that is of a step and has it."""
        last = self._rows[-1] if self._rows else {}
        return float(last[name]) if last.get(STEP) == str(step) and last.get(name) else None

    def open(self) -> None:
        """Writes the file up to the step resumed from, and begins a new one for TensorBoard.

        Raises:
            UserError: without write access.
        """
        with self._writing():
            if self._problem is not None:
                aside = self._path.with_name(CSV + CHANGED)
                if self._path.exists():
                    self._path.replace(aside)
                    self._problem += f"; what it held is in {aside}"
                self._say(self._problem)
            self._rewrite(list(self._rows[0]) if self._rows else [STEP])
            self._events = Events(self._path.parent / TENSORBOARD, self._step + 1 if self._step else None)

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Appends a row.

        Raises:
            UserError: if the disk is full.
        """
        if self._events is None:
            self.open()
        assert self._events is not None
        with self._writing():
            self._append(step, metrics)
            self._events.write(step, metrics)

    def close(self, quietly: bool = False) -> None:
        """Puts everything on the disk and closes the files; `quietly`: as far as it can be.

        Raises:
            UserError: if the disk is full.
        """
        if self._events is None:
            return
        if quietly:
            with contextlib.suppress(OSError):
                self._close_file()
            self._events.abandon()
            return
        with self._writing():
            self._close_file()
            self._events.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise unwritable(error.filename or self._path.parent, error, "choose another --out") from error

    def _append(self, step: int, metrics: Mapping[str, float]) -> None:
        row = {STEP: str(step)} | {name: _number(value) for name, value in metrics.items()}
        self._rows.append(row)
        new = [name for name in row if name not in self._columns]
        if new or self._file is None or not self._in_place(self._file):
            self._rewrite([*self._columns, *new])
        else:
            csv.DictWriter(self._file, self._columns, restval="").writerow(row)
            self._file.flush()

    def _in_place(self, file: TextIO) -> bool:
        """Whether the file is still that of the name; an editor may have put another one there."""
        try:
            return os.path.samestat(os.fstat(file.fileno()), self._path.stat())
        except FileNotFoundError:
            return False

    def _close_file(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _rewrite(self, columns: list[str]) -> None:
        """Writes the whole file anew, under another name first, so that a kill loses nothing."""
        partial = self._path.with_name(CSV + PARTIAL)
        self._close_file()
        self._columns = columns
        with open_new(partial) as file:
            try:
                rows_lib.write(file, self._rows, columns)
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                partial.unlink()
                raise
        partial.replace(self._path)
        self._file = self._path.open("a", newline="")


def _recovered(path: Path, step: int, kept: str | None) -> tuple[Rows, str | None]:
    """The rows of a run up to a step, and what is wrong with their file, or None."""
    found, broken = rows_lib.parse(path.read_bytes()) if path.exists() else ([], 0)
    found = [row for row in found if int(row[STEP]) <= step]
    if kept is not None:
        rows, _ = rows_lib.parse(kept.encode())
        if not broken and rows_lib.filled(found) == rows_lib.filled(rows):
            return rows, None
        return rows, f"{path} is not as it was written: its {len(rows)} rows come from the checkpoint"
    if broken and step:
        return found, f"{path} has {broken} lines that are no rows of this run: the other {len(found)} are kept"
    return found, None


def _number(value: float) -> str:
    return repr(float(value))
