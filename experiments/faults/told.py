"""The campaign's figures in words, as docs/reliability.md has them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from loco_mjx.compare.markup import markdown

DOCUMENT = Path(__file__).parents[2] / "docs" / "reliability.md"
BEGIN, END = "<!-- figures: written by python -m experiments.faults -->", "<!-- end of the figures -->"
# Of each part what it is and what came of it, in terms of its figures.
WORDS = {
    "kills": (
        "{injected} kills of {runs} runs",
        "runs lost: {runs_lost}; the others went on to the same end",
    ),
    "corruptions": (
        "{injected} damaged runs",
        "{went_on} went on to the same end, {refused} refused; tracebacks: {tracebacks}; wrong ends: {wrong}; refusals "
        "that wrote something: {wrote}",
    ),
    "disks": ("{injected} full disks", "{ended} runs ended by themselves in one line, {went_on} went on"),
    "lines": (
        "{injected} command lines that cannot be",
        "{refused} refused with a reason; tracebacks: {tracebacks}; accepted: {accepted}; hung: {hangs}; written "
        "something: {wrote}; not told clearly: {unclear}",
    ),
    "robots": ("{injected} faults of a robot, each another one", "{sit_downs} told their cause and ended lying down"),
    "memory": (
        "{iterations} iterations of one run",
        "{early_mb} MB of memory in the second fifth, {late_mb} MB in the last: {growth_mb:+} MB",
    ),
}
NONE = "not in the committed figures yet"


def table(figures: Mapping[str, Mapping[str, Any]]) -> str:
    """The figures as Markdown; parts that have not been run are named."""
    rows = []
    for name, (what, came) in WORDS.items():
        found = figures.get(name)
        rows.append((name, NONE) if found is None else (what.format(**found), came.format(**found)))
    return markdown(["what was injected", "what came of it"], rows).rstrip("\n")


def write(figures: Mapping[str, Mapping[str, Any]]) -> None:
    """Puts the table into the document."""
    before, rest = DOCUMENT.read_text().split(BEGIN)
    after = rest.split(END)[1]
    DOCUMENT.write_text(f"{before}{BEGIN}\n{table(figures)}\n{END}{after}")
