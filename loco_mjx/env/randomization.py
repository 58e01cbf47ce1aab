"""Domain randomisation: one draw per episode (paper, appendix A; ranges in RandomizationConfig)."""

from __future__ import annotations

from dataclasses import fields

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import EnvConfig
from loco_mjx.physics.step import Dynamics, nominal_dynamics


@struct.dataclass
class Randomization:
    """What differs between episodes.

    Attributes:
        dynamics: gains, motors, masses and friction of this episode.
        latency: (), delay of the IMU and the joint angles, s.
    """

    dynamics: Dynamics
    latency: jax.Array


def _uniform(key: jax.Array, bounds: tuple[float, float], shape: tuple[int, ...] = ()) -> jax.Array:
    return jax.random.uniform(key, shape, minval=bounds[0], maxval=bounds[1])


def nominal(config: EnvConfig) -> Randomization:
    """The robot as specified, without latency."""
    return Randomization(nominal_dynamics(config.kp, config.kd, config.physics.friction), jp.zeros(()))


def draw(key: jax.Array, config: EnvConfig) -> Randomization:
    """One episode's robot: drawn from the configured ranges, or the nominal one where randomisation is off.

    Every field of Dynamics is drawn uniformly from the range of its name in RandomizationConfig, in the shape that it
    has without randomisation; and so is the latency.
    """
    ranges = config.randomization
    if not ranges.enabled:
        return nominal(config)
    nominal_robot = nominal(config)
    quantities = [field.name for field in fields(Dynamics)]
    *keys, latency_key = jax.random.split(key, len(quantities) + 1)
    drawn = {
        name: _uniform(own, getattr(ranges, name), getattr(nominal_robot.dynamics, name).shape)
        for name, own in zip(quantities, keys, strict=True)
    }
    return Randomization(Dynamics(**drawn), _uniform(latency_key, ranges.latency))
