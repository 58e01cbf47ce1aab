"""Which metrics of an evaluation are displayed, and in which order: the most important first, empty ones left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

PER_METRE = "collisions_per_metre"
NOTHING = "—"  # where there is no figure
_STEPS = "steps"
# Metrics that are left out if they equal another one: without a goal, or if every contact is a collision.
_TWINS = {"progress": "distance", "contacts": "collisions"}
_OF_GOALS = ("reached_goal", "at_goal")  # metrics that are left out without a goal


@dataclass(frozen=True)
class DisplayedMetric:
    """A metric as it is shown.

    Attributes:
        name: of the metric.
        label: in words.
        unit: or none.
        digits: after the decimal point.
        inverse: 1 − value is shown.
    """

    name: str
    label: str
    unit: str = ""
    digits: int = 2
    inverse: bool = False

    def value(self, value: float) -> str:
        """One value in words, without its unit; what rounds to nothing has no sign."""
        return f"{round(1 - value if self.inverse else value, self.digits) + 0.0:.{self.digits}f}"

    def mean(self, figures: Mapping[str, Any] | None) -> str:
        """The mean in words, with its unit."""
        if figures is None:
            return NOTHING
        return f"{self.value(figures['mean'])} {self.unit}".rstrip()

    def std(self, figures: Mapping[str, Any] | None) -> str:
        """The deviation in words."""
        return "" if figures is None else f"{figures['std']:.{self.digits}f}"


DISTANCE = DisplayedMetric("distance", "distance", "m")
LEADING = (
    DISTANCE,
    DisplayedMetric("collisions", "collisions", _STEPS, 1),
    DisplayedMetric(PER_METRE, "collisions per metre"),
    DisplayedMetric("speed", "mean speed", "m/s"),
    DisplayedMetric("return", "return", digits=1),
    DisplayedMetric("length", "length", _STEPS, 1),
    DisplayedMetric("survived", "falls", "of the episodes", inverse=True),
    DisplayedMetric("distance_16s", "distance, first 16 s", "m"),
    DisplayedMetric("collisions_16s", "collisions, first 16 s", _STEPS, 1),
)
FOLLOWING = (
    DisplayedMetric("progress", "progress to the goal", "m"),
    DisplayedMetric("reached_goal", "came within 1 m of the goal", "of the episodes"),
    DisplayedMetric("at_goal", "within 1 m of the goal", _STEPS, 1),
    DisplayedMetric("contacts", "contacts", _STEPS, 1),
    DisplayedMetric("spheres", "spheres"),
    DisplayedMetric("nonfinite", "non-finite states"),
)
UNITS = {"distance": "m", "progress": "m", "speed": "m/s"}
UNITS |= dict.fromkeys(("length", "collisions", "contacts", "at_goal"), _STEPS)


def order(metrics: Mapping[str, Mapping[str, Any]], task: str) -> tuple[list[DisplayedMetric], list[str]]:
    """The metrics to display, and the names of those left out because they were zero in every episode.

    Args:
        metrics: mean and std of each.
        task: that they are of.

    Returns:
        The metrics of every task first, measured or not; then others that are not zero; and the names of the zero ones.
    """
    known = {one.name: one for one in FOLLOWING}
    others = [name for name in metrics if name not in known and name not in {one.name for one in LEADING}]
    shown, zero = list(LEADING), []
    goal = not _same(metrics, "progress", _TWINS["progress"])
    for name in (*known, *others):
        if name not in metrics or _same(metrics, name, _TWINS.get(name)) or (name in _OF_GOALS and not goal):
            continue
        about = name == "reached_goal" or (task.endswith("-sphere") and "sphere" in name)
        if _zero(metrics[name]) and not about:
            zero.append(name)
        else:
            shown.append(known.get(name, DisplayedMetric(name, name)))
    return shown, zero


def caption(zero: list[str]) -> str | None:
    """The line below a table on what it leaves out."""
    return f"zero in every episode: {', '.join(zero)}" if zero else None


def _zero(figures: Mapping[str, Any]) -> bool:
    return not figures["mean"] and not figures["std"]


def _same(metrics: Mapping[str, Mapping[str, Any]], name: str, other: str | None) -> bool:
    return other is not None and name in metrics and metrics[name] == metrics.get(other)
