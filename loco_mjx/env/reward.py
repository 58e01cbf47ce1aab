"""The reward, term by term, and what ends an episode (paper, appendix A.2).

R = α_fwd R_fwd + α_energy R_energy + α_alive R_alive + Σ spheres; further terms have weight 0.
A new term is one function under :func:`register_reward`, here or in a module of the user's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, overload

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import RewardConfig, TerminationConfig
from loco_mjx.config.reward_terms import REWARDS, Term
from loco_mjx.errors import UserError
from loco_mjx.registry import caller


@struct.dataclass
class RewardInputs:
    """What happened in one control step: what the reward, the metrics and the terminations are functions of.

    Attributes:
        displacement: (3,) of the base, world frame, m.
        velocity: (3,) the same per second, m/s.
        forward: (), displacement along the task's forward direction, m.
        forward_velocity: (), the same per second, m/s.
        speed: (), this, at most `reward.target_speed`, m/s.
        distance: (), m by which the episode's `distance` has grown.
        goal_distance: (), from the base to the task's goal in three dimensions, m; infinite without a goal.
        torque_squared: (), ‖τ‖² averaged over the physics steps, (N·m)².
        spheres: (), spheres collected.
        contact: (), bool, whether the robot touched an obstacle or wall.
        passed: (), bool, whether it is beyond the first obstacle's centre.
        dropped: (), obstacles within the robot's reach that physics left out.
        action: (12,) joint targets relative to the default pose, rad; or the whole-body controller's command (2,).
        last_action: (12,) those of the step before.
        action_change: (), ‖u_t − u_{t−1}‖², in units of the action's scale.
        up: (), z of the trunk's up axis.
        height: (), base above the ground beneath it, m.
        qpos: (19,) after the step: base position, quaternion (w, x, y, z), joint angles; m, rad.
        qvel: (18,) after the step: base velocity (world frame), angular velocity (trunk's frame), joint speeds.
        finite: (), bool, whether physics gave numbers.
    """

    displacement: jax.Array
    velocity: jax.Array
    forward: jax.Array
    forward_velocity: jax.Array
    speed: jax.Array
    distance: jax.Array
    goal_distance: jax.Array
    torque_squared: jax.Array
    spheres: jax.Array
    contact: jax.Array
    passed: jax.Array
    dropped: jax.Array
    action: jax.Array
    last_action: jax.Array
    action_change: jax.Array
    up: jax.Array
    height: jax.Array
    qpos: jax.Array
    qvel: jax.Array
    finite: jax.Array


Function = TypeVar("Function", bound=Callable[[RewardInputs], jax.Array])


@overload
def register_reward(name: str, *, weight: float | None = 1.0) -> Callable[[Function], Function]: ...


@overload
def register_reward(name: str, function: Function, *, weight: float | None = 1.0) -> Function: ...


def register_reward(name: str, function: Any = None, *, weight: float | None = 1.0) -> Any:
    """Adds a term to the reward: as a decorator of a function, or called with it.

    ``@register_reward("smooth", weight=0.01)`` above ``def smooth(step): return -jp.sum(step.qvel[6:] ** 2)``. The
    configuration's `env.reward.NAME` is its weight, and `reward/NAME` a metric of every episode. A weight of 0 leaves
    the term out of the program.

    Args:
        name: of small letters, digits and `_`.
        function: from :class:`RewardInputs` of one environment to ().
        weight: unless the configuration says otherwise.

    Raises:
        UserError: if the name is taken or no name, or the weight no number.
    """
    origin = caller()

    def register(function: Any) -> Any:
        if name in RewardConfig.__dataclass_fields__ and origin is not None:
            raise UserError(f"env.reward.{name} is a key of the configuration already; choose another name")
        if weight is not None and not math.isfinite(weight):
            raise UserError(f"the weight of reward term '{name}' is {weight}; accepted: a number")
        REWARDS.register(name, Term(function, weight), origin)
        return function

    return register if function is None else register(function)


@register_reward("forward", weight=None)
def _forward(step: RewardInputs) -> jax.Array:
    return step.speed


@register_reward("energy", weight=None)
def _energy(step: RewardInputs) -> jax.Array:
    return -step.torque_squared


@register_reward("alive", weight=None)
def _alive(step: RewardInputs) -> jax.Array:
    return jp.ones(())


@register_reward("sphere", weight=None)
def _sphere(step: RewardInputs) -> jax.Array:
    return step.spheres


@register_reward("vertical_speed", weight=None)
def _vertical_speed(step: RewardInputs) -> jax.Array:
    return -(step.velocity[2] ** 2)


@register_reward("collision", weight=None)
def _collision(step: RewardInputs) -> jax.Array:
    return -step.contact.astype(jp.float32)


@register_reward("action_rate", weight=None)
def _action_rate(step: RewardInputs) -> jax.Array:
    return -step.action_change


def weights(config: RewardConfig) -> dict[str, float]:
    """The weight of every term that is computed, in the order of the registry.

    Raises:
        UnknownNameError: if the configuration names a term that nobody registered.
    """
    for name in config.terms:
        REWARDS.find(name)
    own = {name: float(getattr(config, name)) for name, term in REWARDS.items() if term.weight is None}
    return own | {name: float(config.terms[name]) for name in REWARDS if config.terms.get(name)}


def rewards(step: RewardInputs, config: RewardConfig) -> dict[str, jax.Array]:
    """Every term by name, weighted; the step's reward is their sum.

    Raises:
        UserError: if a term is not one number.
    """
    terms = {}
    for name, weight in weights(config).items():
        value = jp.asarray(REWARDS[name].function(step), jp.float32)
        if value.shape:
            raise UserError(f"reward term '{name}' has the shape {value.shape}; accepted: (), one number")
        terms[name] = weight * value
    return terms


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


def forward_speed(velocity: jax.Array, config: RewardConfig) -> jax.Array:
    """What counts of a forward velocity, m/s."""
    return velocity if config.target_speed is None else jp.minimum(velocity, config.target_speed)


def terminated(step: RewardInputs, config: TerminationConfig) -> jax.Array:
    """Whether the robot has fallen (or, where asked, collided)."""
    fallen = (step.up < config.min_up) | (step.height < config.min_height)
    return fallen | step.contact if config.on_collision else fallen
