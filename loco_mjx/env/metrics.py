"""What is reported of every control step: increments, whose sums over an episode are the episode's metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import jax
import jax.numpy as jp

from loco_mjx.config import RewardConfig
from loco_mjx.env.reward import RewardInputs, weights

AT_GOAL = 1.0  # m from the base to the goal, within which the robot is there

METRICS: dict[str, Callable[[RewardInputs], jax.Array]] = {
    "distance": lambda step: step.distance,
    "progress": lambda step: step.forward,
    "at_goal": lambda step: (step.goal_distance < AT_GOAL).astype(jp.float32),
    "speed": lambda step: step.forward_velocity,
    "collisions": lambda step: step.contact.astype(jp.float32) * step.passed,
    "contacts": lambda step: step.contact.astype(jp.float32),
    "contacts/dropped": lambda step: step.dropped,
    "spheres": lambda step: step.spheres,
    "nonfinite": lambda step: 1.0 - step.finite.astype(jp.float32),
}


def measure(step: RewardInputs, terms: dict[str, jax.Array], facts: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """A step's metrics, those of its controller, and the terms of its reward as `reward/NAME`."""
    return {name: metric(step) for name, metric in METRICS.items()} | facts | _of_terms(terms)


def before_first_step(config: RewardConfig, facts: Iterable[str]) -> dict[str, jax.Array]:
    """Zeros of the same names; `facts` are those of the controller's metrics."""
    names = (*METRICS, *facts, *_of_terms(dict.fromkeys(weights(config), jp.zeros(()))))
    return {name: jp.zeros(()) for name in names}


def _of_terms(terms: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return {f"reward/{name}": value for name, value in terms.items()}
