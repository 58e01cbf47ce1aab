"""What happened in a run: kept tick by tick, written as one .npz, summed up in a few lines."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from loco_mjx.errors import UserError

PERCENTILES = (50, 90, 99, 100)


@dataclass
class Record:
    """The ticks of a run.

    Attributes:
        rows: one dictionary of arrays per tick, all with the same keys.
        events: (robot time s, text).
        cause: why the run ended before its time; None if it did not.
        detail: more about it.
        distance: m, Euclidean, from the run's start to its end; None if the robot does not know where it is.
        misses: deadlines missed.
        clamped: commands changed by a clamp.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    cause: str | None = None
    detail: str = ""
    distance: float | None = None
    misses: int = 0
    clamped: int = 0

    def latencies(self) -> dict[str, float]:
        """Percentiles of the ticks' latency, ms."""
        values = [1000 * row["latency"] for row in self.rows] or [float("nan")]
        return {f"p{p}": float(np.percentile(values, p)) for p in PERCENTILES}

    def summary(self) -> dict[str, Any]:
        """What is printed."""
        return {
            "ticks": len(self.rows),
            "distance": self.distance,
            "cause": self.cause,
            "detail": self.detail,
            "deadline_misses": self.misses,
            "clamped_commands": self.clamped,
            "latency_ms": self.latencies(),
        }

    def save(self, path: Path) -> None:
        """Writes everything.

        Raises:
            UserError: without write access.
        """
        names = self.rows[0] if self.rows else {}
        columns = {name: np.array([row[name] for row in self.rows]) for name in names}
        about = json.dumps(self.summary() | {"events": self.events})
        try:
            with path.open("wb") as file:
                np.savez_compressed(file, about=np.array(about), **columns)  # type: ignore[arg-type]
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror or error}") from error
