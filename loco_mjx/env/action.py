"""The action: what a policy's numbers in [−1, 1] mean to the joints; for JAX and for NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx.config import ActionConfig
from loco_mjx.robots import LEGS

# With `diagonal`, FR and RL take the first three numbers, FL and RR the others; joints are in the order FR, FL, RR, RL.
DIAGONAL = (0, 1, 2, 3, 4, 5, 3, 4, 5, 0, 1, 2)


def scale(config: ActionConfig) -> np.ndarray:
    """(12,) rad, what 1 means to each joint."""
    return np.tile(np.array(config.scale), len(LEGS))


def of_joints(action: Any, config: ActionConfig) -> Any:
    """A policy's action (..., 6 or 12) to one number for each joint (..., 12)."""
    return action[..., np.array(DIAGONAL)] if config.diagonal else action


def of_policy(joints: Any, config: ActionConfig) -> Any:
    """The inverse of :func:`of_joints`: (..., 12) to (..., 6 or 12)."""
    return joints[..., : config.size]
