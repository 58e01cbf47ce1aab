"""Rows of a run's curves: what an iteration's metrics are for each of the runs that train side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Row = dict[str, float]


def of_runs(metrics: Mapping[str, Any], count: int) -> list[Row]:
    """Each run's metrics, from one value of each or an array of (runs,).

    Means over no episodes are not zero, they are not there.
    """
    rows = [{name: float(np.ravel(value)[i]) for name, value in metrics.items()} for i in range(count)]
    return [
        {name: value for name, value in row.items() if row.get("episodes") != 0 or not name.startswith("episode/")}
        for row in rows
    ]


def means(rows: Sequence[Row]) -> Row:
    """The mean of each metric over the runs that have it."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.items():
            values.setdefault(name, []).append(value)
    return {name: sum(found) / len(found) for name, found in values.items()}
