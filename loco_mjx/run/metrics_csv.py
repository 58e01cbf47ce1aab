"""The rows of `metrics.csv`: written, read back, and told from what a kill or somebody else has made of them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

STEP = "step"
Rows = list[dict[str, str]]
_STEP_FORM = re.compile(r"\d{1,18}", re.ASCII)


def write(file: TextIO, rows: Rows, columns: Sequence[str]) -> None:
    """Writes a header and rows; what a row has not is left empty."""
    writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)


def text_of(rows: Rows, columns: Sequence[str]) -> str:
    """What `write` writes."""
    page = io.StringIO(newline="")
    write(page, rows, columns)
    return page.getvalue()


def read(path: Path, up_to: int | None = None) -> Rows:
    """The rows of a metrics file; what is none, such as one that a kill cut short, is left out.

    Args:
        path: of the file; none is an empty one.
        up_to: leave out rows beyond this step.
    """
    if not path.exists():
        return []
    with path.open(newline="", errors="replace") as file:
        rows = [row for row in _readable(csv.DictReader(file)) if None not in row.values() and None not in row]
    rows = [row for row in rows if _STEP_FORM.fullmatch(row.get(STEP, ""))]
    return [row for row in rows if up_to is None or int(row[STEP]) <= up_to]


def parse(content: bytes) -> tuple[Rows, int]:
    """The rows that are as a run writes them, and how many lines are not.

    Such a row has a number or nothing in every column, and its step is beyond the one before. A last line without an
    end is what a kill cut short; it is no row and does not count.
    """
    header, *lines = content.decode(errors="replace").split("\n")[:-1] or [""]
    columns = header.rstrip("\r").split(",")
    if STEP not in columns:
        return [], len(lines) + bool(header)
    rows: Rows = []
    for line in lines:
        cells = line.rstrip("\r").split(",")
        row = dict(zip(columns, cells, strict=False))
        if len(cells) == len(columns) and _is_row(row) and (not rows or int(row[STEP]) > int(rows[-1][STEP])):
            rows.append(row)
    return rows, len(lines) - len(rows)


def filled(rows: Rows) -> Rows:
    """Rows without their empty cells."""
    return [{name: cell for name, cell in row.items() if cell} for row in rows]


def _is_row(row: dict[str, str]) -> bool:
    try:
        for cell in row.values():
            float(cell or 0.0)
    except ValueError:
        return False
    return _STEP_FORM.fullmatch(row[STEP]) is not None


def _readable(reader: Iterator[dict[str, str]]) -> Iterator[dict[str, str]]:
    """Without lines that the csv module cannot read."""
    while True:
        try:
            yield next(reader)
        except StopIteration:
            return
        except csv.Error:
            continue
