"""Results as a table for people, or as exactly one JSON object on stdout."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from loco_mjx.errors import UserError

Show = Callable[[dict[str, Any], Any], None]


@contextlib.contextmanager
def one_object(as_json: bool) -> Iterator[Show]:
    """Gives a function that shows a result, to be called once: `show(result, table)`.

    With JSON, whatever else is printed meanwhile goes to stderr, so that stdout holds the object alone.

    Args:
        as_json: whether to print JSON, or the table (anything rich can print).
    """
    stdout = sys.stdout

    def show(result: dict[str, Any], table: Any) -> None:
        if as_json:
            print(json.dumps(result), file=stdout)
        else:
            from rich.console import Console

            Console(file=stdout).print(table)

    with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
        yield show


def write_text(path: Path, text: str) -> None:
    """Writes a file, and its directory where there is none.

    Raises:
        UserError: without write access.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror or error}; choose a writable directory") from error
