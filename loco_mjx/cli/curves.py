"""`loco-mjx curves`: draws training and evaluation curves, mean and deviation over seeds, as PNG and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from loco_mjx.cli.parse import parse

PROG = "loco-mjx curves"


@dataclass(frozen=True)
class Options:
    """Draws the curves of the runs in a directory: one figure per task, one line per policy, over its seeds."""

    directory: tyro.conf.Positional[Path]
    """Directory of the runs, however deep."""
    out: Path | None = None
    """Directory for TASK.png and TASK.svg; None: curves/ in that of the runs."""
    mixed_versions: bool = False
    """Accept runs trained with different versions of loco-mjx, MuJoCo or JAX."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if there is nothing to draw; nothing is written then.
    """
    options = parse(Options, args, PROG)
    from loco_mjx.compare import curves

    files, notes = curves.draw(options.directory, options.out or options.directory / "curves", options.mixed_versions)
    for note in notes:
        print(note)
    for path in files:
        print(f"written: {path}")
    return 0
