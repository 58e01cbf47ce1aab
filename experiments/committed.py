"""The committed results, as those read them who write documents."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

from loco_mjx.compare.markup import mean_and_std
from loco_mjx.evaluation.display import NOTHING

# Beside distance and collisions: metrics and their digits, and in words.
BESIDE = {"speed": 2, "collisions_per_metre": 2, "distance_16s": 2, "collisions_16s": 0}
BESIDE_WORDS = ("speed", "collisions per m", "distance, first 16 s", "collisions, first 16 s")
RESULTS = Path(__file__).parent / "results" / "cpu"


class Named(Protocol):
    """What has a name."""

    @property
    def name(self) -> str:
        """By which the command line knows it."""


T = TypeVar("T", bound=Named)


def rows(path: Path) -> list[dict[str, float]]:
    """A metrics.csv as numbers; empty cells are left out."""
    with path.open() as file:
        return [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(file)]


def keep(run: Path, target: Path, results: Mapping[str, Any] | None = None) -> None:
    """Copies curves, configuration and provenance of a run into the results, without paths of the machine it ran on.

    Args:
        run: directory of the run.
        target: where to; made if need be.
        results: what else is kept, each as a JSON file of that name.
    """
    target.mkdir(parents=True, exist_ok=True)
    for name in ("metrics.csv", "config.json"):
        shutil.copyfile(run / name, target / name)
    info = json.loads((run / "info.json").read_text())
    for start in (info, *info.get("resumed", [])):
        start["command"][start["command"].index("--out") + 1] = target.name
    for name, content in ({"info": info} | dict(results or {})).items():
        (target / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")


def chosen(names: list[str], known: Iterable[T]) -> list[T]:
    """Those of some things that are named, in their own order.

    Raises:
        SystemExit: on a name that none has.
    """
    found = {thing.name: thing for thing in known}
    for name in names:
        if name not in found:
            raise SystemExit(f"unknown name '{name}'; accepted: {', '.join(found)}")
    return [thing for name, thing in found.items() if name in names]


def runs() -> dict[str, Path]:
    """The learning runs that have results, by name."""
    return {path.parent.name: path.parent for path in sorted((RESULTS / "learning").glob("*/evaluation.json"))}


def len_episodes(found: dict[str, Path]) -> int:
    """How many episodes the evaluations have; they agree."""
    counts = {json.loads((p / "evaluation.json").read_text())["num_episodes"] for p in found.values()}
    if len(counts) != 1:
        raise SystemExit(f"the evaluations have different numbers of episodes: {sorted(counts)}")
    return counts.pop()


def figure(metrics: list[dict[str, dict[str, float]]], name: str, digits: int) -> str:
    """Mean ± standard deviation over seeds of a metric, of one seed the mean; a dash unless all have it."""
    if any(name not in one for one in metrics):
        return NOTHING
    return mean_and_std([one[name]["mean"] for one in metrics], digits)
