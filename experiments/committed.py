"""The committed results, as those read them who write documents."""

from __future__ import annotations

import csv
import json
from pathlib import Path

RESULTS = Path(__file__).parent / "results" / "cpu"


def rows(path: Path) -> list[dict[str, float]]:
    """A metrics.csv as numbers; empty cells are left out."""
    with path.open() as file:
        return [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(file)]


def runs() -> dict[str, Path]:
    """The learning runs that have results, by name."""
    return {path.parent.name: path.parent for path in sorted((RESULTS / "learning").glob("*/evaluation.json"))}


def table(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def len_episodes(found: dict[str, Path]) -> int:
    """How many episodes the evaluations have; they agree."""
    counts = {json.loads((p / "evaluation.json").read_text())["num_episodes"] for p in found.values()}
    if len(counts) != 1:
        raise SystemExit(f"the evaluations have different numbers of episodes: {sorted(counts)}")
    return counts.pop()
