"""`loco-mjx table`: writes tables of the evaluations in a directory: a summary, each task, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from loco_mjx.cli.output import write_text
from loco_mjx.cli.parse import parse

PROG = "loco-mjx table"


@dataclass(frozen=True)
class Options:
    """Writes the evaluations of the runs in a directory as Markdown and LaTeX.

    First a summary, policy by task; then each task's own evaluations; then those of the paper's tables 1 to 5 of which
    something has been evaluated. All stand on the finished seeds; what is missing is listed below the tables.
    """

    directory: tyro.conf.Positional[Path]
    """Directory of the runs, however deep."""
    out: Path | None = None
    """Directory for tables.md and tables.tex; None: that of the runs."""
    mixed_versions: bool = False
    """Accept evaluations made by different versions of loco-mjx, MuJoCo or JAX."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if there is nothing to compare, or it cannot be compared; nothing is written then.
    """
    options = parse(Options, args, PROG)
    from loco_mjx.compare import render, tables

    findings = tables.fill(options.directory, options.mixed_versions)
    out = options.out or options.directory
    text = render.markdown(findings)
    write_text(out / "tables.md", text)
    write_text(out / "tables.tex", render.latex(findings))
    print(text)
    print(f"written: {out / 'tables.md'}, {out / 'tables.tex'}")
    return 0
