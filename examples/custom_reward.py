"""Terms of the reward of one's own: functions of what happened in a control step.

loco-mjx train --import examples/custom_reward.py --task thin --env.reward.calm 0.002 --env.reward.straight 0
"""

import jax
import jax.numpy as jp

import loco_mjx
from loco_mjx.env.reward import RewardInputs


@loco_mjx.register_reward("calm", weight=0.001)
def calm(step: RewardInputs) -> jax.Array:
    """Slow joints are better: −‖joint speeds‖², rad²/s²."""
    return -jp.sum(step.qvel[6:] ** 2)


@loco_mjx.register_reward("straight", weight=0.1)
def straight(step: RewardInputs) -> jax.Array:
    """As is walking without drifting to a side: −|v_y|, m/s."""
    return -jp.abs(step.velocity[1])
