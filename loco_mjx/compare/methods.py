"""What was measured of each method on each task: its seeds' evaluations, put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from loco_mjx.compare import paper
from loco_mjx.evaluation.display import LEADING, NOTHING, PER_METRE, DisplayedMetric
from loco_mjx.run import results
from loco_mjx.run.results import Evaluation, OverSeeds, Run

# Of the metrics, those of a sweep's summary.
_BRIEFLY = ("distance", "collisions", PER_METRE, "speed", "distance_16s", "collisions_16s")
BRIEFLY = tuple(shown for shown in LEADING if shown.name in _BRIEFLY)


@dataclass(frozen=True)
class Method:
    """A policy trained on one task, evaluated on the same or another.

    Attributes:
        label: the policy, and what was changed of it.
        trained_on: task.
        evaluated_on: task.
        evaluations: one per seed, all after the same number of samples.
    """

    label: str
    trained_on: str
    evaluated_on: str
    evaluations: tuple[Evaluation, ...]

    @property
    def where(self) -> str:
        """The task, or both: `thin → wide`."""
        own = self.trained_on == self.evaluated_on
        return self.evaluated_on if own else f"{self.trained_on} → {self.evaluated_on}"

    def over_seeds(self, metric: str) -> OverSeeds | None:
        """A metric over the seeds; None unless every seed's evaluation has it, which older ones may not."""
        if any(metric not in one.metrics for one in self.evaluations):
            return None
        return results.over_seeds([one.metrics[metric] for one in self.evaluations])

    def figure(self, shown: DisplayedMetric) -> str:
        """A metric as text: mean ± standard deviation over seeds; of one seed the mean."""
        found = self.over_seeds(shown.name)
        if found is None:
            return NOTHING
        spread = f" ± {found.std:.{shown.digits}f}" if len(found.values) > 1 else ""
        return shown.value(found.mean) + spread


def methods(evaluations: Sequence[Evaluation]) -> tuple[Method, ...]:
    """Evaluations put together by method and task: a task's own first, policies in the paper's order, others after.

    Of each method only the runs that were trained on most samples count.

    Raises:
        UserError: if runs of one method were trained in different ways.
    """
    groups: dict[tuple[str, str, str], list[Evaluation]] = {}
    for one in evaluations:
        label, task = results.variant_of(one.run.flat).label, one.run.config.env.task
        groups.setdefault((label, task, one.task), []).append(one)
    found = []
    for key, group in groups.items():
        most = max(one.samples for one in group)
        used = sorted((one for one in group if one.samples == most), key=lambda one: one.run.config.seed)
        results.check_same_method([one.run for one in used], f"{key[0]} on {key[1]}")
        found.append(Method(*key, tuple(used)))
    return tuple(sorted(found, key=_place))


def of_runs(runs: Sequence[Run]) -> tuple[Method, ...]:
    """The methods of runs.

    Raises:
        UserError: if an evaluation cannot be read, or runs of one method were trained in different ways.
    """
    return methods(results.find_evaluations(runs))


def places(found: Sequence[Method]) -> list[str]:
    """Every task, or pair of tasks, that something was measured on, in order."""
    return list(dict.fromkeys(one.where for one in sorted(found, key=_place)))


def labels(found: Sequence[Method]) -> list[str]:
    """Every policy, in order."""
    return sorted({one.label for one in found}, key=_rank)


def basis(one: Method) -> list[str]:
    """What its figures stand on: samples, seeds, episodes of each evaluation."""
    episodes = sorted({evaluation.episodes for evaluation in one.evaluations})
    said = "–".join(f"{count:,}" for count in dict.fromkeys((episodes[0], episodes[-1])))
    return [f"{one.evaluations[0].samples:,}", str(len(one.evaluations)), said]


def heads() -> list[str]:
    """The columns of what is shown of a method: every metric that matters with its unit, then what it stands on."""
    units = [f"{one.label} ({one.unit})" if one.unit else one.label for one in LEADING]
    return [*units, "samples", "seeds", "episodes"]


def overview(found: Sequence[Method]) -> Table:
    """The metrics that matter of each task and policy, for a terminal."""
    table = Table(title="evaluations: mean ± standard deviation over seeds", title_justify="left")
    for name in ("task", "policy"):
        table.add_column(name, overflow="fold")
    for shown in BRIEFLY:
        table.add_column(f"{shown.label}, {shown.unit}" if shown.unit else shown.label, justify="right")
    table.add_column("seeds", justify="right")
    for one in found:
        figures = [one.figure(shown) for shown in BRIEFLY]
        table.add_row(one.where, one.label, *figures, str(len(one.evaluations)))
    return table


def _rank(label: str) -> tuple[int, str]:
    known = [variant.label for variant in paper.POLICIES.values()]
    return (known.index(label) if label in known else len(known), label)


def _place(one: Method) -> tuple[bool, str, str, tuple[int, str]]:
    return (one.trained_on != one.evaluated_on, one.trained_on, one.evaluated_on, _rank(one.label))
