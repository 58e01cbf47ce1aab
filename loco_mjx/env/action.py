"""How an action in [−1, 1] becomes what the controller takes, and back; for JAX's arrays and NumPy's alike.

What it takes is `neutral` + `scale` · the action's numbers: joint targets, or the whole-body controller's commands.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx.config import ActionConfig, EnvConfig
from loco_mjx.controllers import get_controller
from loco_mjx.robots import LEGS, get_robot

# Of a diagonal action's six numbers, the one that each of the 12 joints takes: FR and RL share three, FL and RR three.
DIAGONAL = (0, 1, 2, 3, 4, 5, 3, 4, 5, 0, 1, 2)


def joint_scale(config: ActionConfig) -> np.ndarray:
    """(12,) rad per unit of the action, of every joint."""
    return np.tile(np.array(config.scale), len(LEGS))


def per_joint(action: Any, config: ActionConfig) -> Any:
    """(..., 12) an action's number for every joint, from (..., 12) or, if diagonal, (..., 6)."""
    return action[..., np.array(DIAGONAL)] if config.diagonal else action


def neutral(config: EnvConfig) -> np.ndarray:
    """What an action of 0 stands for: the robot's default pose, (12,) rad, or the command to stay where it is."""
    controller = get_controller(config.controller)
    return np.array(get_robot(config.robot).default_pose) if controller.scale is None else np.zeros(controller.size)


def scale(config: EnvConfig) -> np.ndarray:
    """What an action of 1 adds to that, of every joint, (12,) rad, or of each command."""
    own = get_controller(config.controller).scale
    return joint_scale(config.action) if own is None else np.array(own)


def numbers(action: Any, config: EnvConfig) -> Any:
    """(..., n) the action's numbers, one for each of `scale`."""
    return per_joint(action, config.action) if get_controller(config.controller).scale is None else action


def to_offsets(action: Any, config: EnvConfig) -> Any:
    """What the controller takes, relative to `neutral`, of an action (..., action_size): (..., 12) rad, or (..., 2)."""
    return numbers(action.clip(-1.0, 1.0), config) * scale(config)


def from_offsets(offsets: np.ndarray, config: EnvConfig) -> np.ndarray:
    """The action (..., action_size) that stands for these (..., n) offsets from `neutral`.

    What has scale 0 has the action 0.
    """
    units = scale(config)
    action = np.divide(offsets, units, out=np.zeros_like(offsets), where=units > 0)
    return action[..., : config.action_size]  # if diagonal, FR and FL; the others follow them
