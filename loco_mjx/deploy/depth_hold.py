"""The depth that a policy without JAX holds between control steps."""

from __future__ import annotations

import numpy as np


class DepthHold:
    """Gives the newest depth at every `hold`-th call, and the same again at those between."""

    def __init__(self, hold: int) -> None:
        """Holds nothing yet; 1 gives the newest depth always."""
        self._hold, self._calls = hold, 0
        self._held: np.ndarray | None = None

    def __call__(self, depth: np.ndarray) -> np.ndarray:
        """What the policy sees where `depth` is the newest; one call for each control step."""
        if self._held is None or self._calls % self._hold == 0:
            self._held = depth
        self._calls += 1
        return self._held
