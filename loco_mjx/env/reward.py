"""The reward, term by term, and what ends an episode (paper, appendix A.2).

R = α_fwd R_fwd + α_energy R_energy + α_alive R_alive + Σ spheres; further terms have weight 0.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import RewardConfig, TerminationConfig


@struct.dataclass
class StepFacts:
    """What happened in one control step, as the reward, the metrics and the terminations need it.

    Attributes:
        displacement: (3,) of the base, world frame, m.
        forward: (), displacement along the task's forward direction, m.
        torque_squared: (), ‖τ‖² averaged over the physics steps, (N·m)².
        spheres: (), spheres collected.
        contact: (), bool, whether the robot touched an obstacle or wall.
        dropped: (), obstacles within the robot's reach that physics left out.
        action_change: (), ‖u_t − u_{t−1}‖².
        up: (), z of the trunk's up axis.
        height: (), base above the ground beneath it, m.
    """

    displacement: jax.Array
    forward: jax.Array
    torque_squared: jax.Array
    spheres: jax.Array
    contact: jax.Array
    dropped: jax.Array
    action_change: jax.Array
    up: jax.Array
    height: jax.Array


def nothing() -> StepFacts:
    """The facts of a step in which nothing happens to a robot that lies flat."""
    zero, no = jp.zeros(()), jp.zeros((), bool)
    return StepFacts(
        displacement=jp.zeros(3),
        forward=zero,
        torque_squared=zero,
        spheres=zero,
        contact=no,
        dropped=zero,
        action_change=zero,
        up=zero,
        height=zero,
    )


def forward_displacement(before: jax.Array, after: jax.Array, goal: jax.Array, toward_goal: bool) -> jax.Array:
    """Metres gained in a step: along +x, or in 3-D distance to the goal.

    Args:
        before: (3,) base position before the step, m.
        after: (3,) base position after it, m.
        goal: (3,) goal position, m.
        toward_goal: whether forward means toward the goal.
    """
    if toward_goal:
        return jp.linalg.norm(goal - before) - jp.linalg.norm(goal - after)
    return after[0] - before[0]


def rewards(facts: StepFacts, config: RewardConfig, dt: float) -> dict[str, jax.Array]:
    """Every term by name, weighted, of a step of dt seconds; its reward is their sum."""
    speed = facts.forward / dt
    if config.target_speed is not None:
        speed = jp.minimum(speed, config.target_speed)
    vertical_speed = facts.displacement[2] / dt
    return {
        "forward": config.forward * speed,
        "energy": -config.energy * facts.torque_squared,
        "alive": config.alive * jp.ones(()),
        "sphere": config.sphere * facts.spheres,
        "vertical_speed": -config.vertical_speed * vertical_speed**2,
        "collision": -config.collision * facts.contact.astype(jp.float32),
        "action_rate": -config.action_rate * facts.action_change,
    }


def terminated(facts: StepFacts, config: TerminationConfig) -> jax.Array:
    """Whether the robot has fallen (or, where asked, collided)."""
    fallen = (facts.up < config.min_up) | (facts.height < config.min_height)
    return fallen | facts.contact if config.on_collision else fallen
