"""How an action in [−1, 1] becomes joint targets, and back; for JAX's arrays and NumPy's alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx.config import ActionConfig
from loco_mjx.robots import LEGS

# Of a diagonal action's six numbers, the one that each of the 12 joints takes: FR and RL share three, FL and RR three.
DIAGONAL = (0, 1, 2, 3, 4, 5, 3, 4, 5, 0, 1, 2)


def joint_scale(config: ActionConfig) -> np.ndarray:
    """(12,) rad per unit of the action, of every joint."""
    return np.tile(np.array(config.scale), len(LEGS))


def per_joint(action: Any, config: ActionConfig) -> Any:
    """(..., 12) an action's number for every joint, from (..., 12) or, if diagonal, (..., 6)."""
    return action[..., np.array(DIAGONAL)] if config.diagonal else action


def to_offsets(action: Any, config: ActionConfig) -> Any:
    """(..., 12) joint targets relative to the default pose, rad, of an action, (..., 12) or, if diagonal, (..., 6)."""
    return per_joint(action.clip(-1.0, 1.0), config) * joint_scale(config)


def from_offsets(offsets: np.ndarray, config: ActionConfig) -> np.ndarray:
    """The action whose joint targets are these (..., 12) offsets from the default pose, rad: (..., 12) or (..., 6).

    A joint of scale 0 has the action 0.
    """
    scale = joint_scale(config)
    action = np.divide(offsets, scale, out=np.zeros_like(offsets), where=scale > 0)
    return action[..., : config.size]  # if diagonal, FR and FL; the others follow them
