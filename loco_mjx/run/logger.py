"""The curves of a run: `metrics.csv` and TensorBoard, without repeated steps after a resumption."""

from __future__ import annotations

import contextlib
import csv
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TextIO

from loco_mjx.errors import unwritable
from loco_mjx.run.events import Events

CSV, TENSORBOARD, STEP, SECONDS = "metrics.csv", "tensorboard", "step", "time/seconds"


def read_rows(path: Path, up_to: int | None = None) -> list[dict[str, str]]:
    """The rows of a metrics file; those that a kill cut short are left out.

    Args:
        path: of the file; none is an empty one.
        up_to: leave out rows beyond this step.
    """
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if None not in row.values() and None not in row]
    rows = [row for row in rows if row.get(STEP, "").isdigit()]
    return [row for row in rows if up_to is None or int(row[STEP]) <= up_to]


class Logger:
    """Writes one row per iteration.

    Columns appear when a metric first does; rows without it leave it empty. Rows beyond the step resumed from are
    dropped, from both the file and the curves, since they are about to be made again.
    """

    def __init__(self, directory: Path, step: int) -> None:
        """Opens the curves of a run at the step it starts or resumes from.

        Raises:
            UserError: without write access.
        """
        self._path = directory / CSV
        self._columns: list[str] = []
        self._file: TextIO | None = None
        try:
            self._rows = read_rows(self._path, up_to=step)
            self._rewrite(list(self._rows[0]) if self._rows else [STEP])
            self._events = Events(directory / TENSORBOARD, step + 1 if step else None)
        except OSError as error:
            raise unwritable(self._path, error, "choose another --out") from error

    @property
    def seconds(self) -> float:
        """Time trained so far, over all starts, as the last row has it."""
        return float(self._rows[-1].get(SECONDS) or 0.0) if self._rows else 0.0

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Appends a row.

        Raises:
            UserError: if the disk is full.
        """
        with self._writing():
            self._append(step, metrics)
            self._events.write(step, metrics)

    def close(self, quietly: bool = False) -> None:
        """Puts everything on the disk and closes the files; `quietly`: as far as it can be.

        Raises:
            UserError: if the disk is full.
        """
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
            raise unwritable(self._path.parent, error, "it has to stay writable") from error

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
        partial = self._path.with_suffix(".csv.partial")
        self._close_file()
        self._columns = columns
        try:
            with partial.open("w", newline="") as file:
                writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
                writer.writeheader()
                writer.writerows(self._rows)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(self._path)
        except OSError:
            with contextlib.suppress(OSError):
                partial.unlink()
            raise
        self._file = self._path.open("a", newline="")


def _number(value: float) -> str:
    return repr(float(value))
