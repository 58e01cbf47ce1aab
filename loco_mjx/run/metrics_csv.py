"""The rows of `metrics.csv`: written, read, and checked, since a kill or an editor may have damaged the file."""

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
    """Writes a header and rows; a column that a row does not have is left empty."""
    writer = csv.DictWriter(file, columns, restval="", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)


def text_of(rows: Rows, columns: Sequence[str]) -> str:
    """What `write` writes."""
    page = io.StringIO(newline="")
    write(page, rows, columns)
    return page.getvalue()


def read(path: Path, up_to: int | None = None) -> Rows:
    """The rows of a metrics file. A damaged row, such as the last one after a kill, is left out.

    Args:
        path: of the file; a missing file has no rows.
        up_to: leave out rows beyond this step.
    """
    if not path.exists():
        return []
    with path.open(newline="", errors="replace") as file:
        rows = [row for row in _readable(csv.DictReader(file)) if None not in row.values() and None not in row]
    rows = [row for row in rows if _STEP_FORM.fullmatch(row.get(STEP, ""))]
    return [row for row in rows if up_to is None or int(row[STEP]) <= up_to]


def parse(content: bytes) -> tuple[Rows, int]:
    """The valid rows, and the number of other lines.

    A valid row has a number or nothing in every column, and a larger step than the row before it. A last line without
    a line end was cut short by a kill: it is ignored, and not counted.
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
