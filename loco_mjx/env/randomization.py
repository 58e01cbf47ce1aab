"""Domain randomisation: one draw per episode (paper, appendix A; ranges in RandomizationConfig)."""

from __future__ import annotations

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import EnvConfig
from loco_mjx.physics.step import Dynamics, nominal_dynamics
from loco_mjx.robots import NJOINT


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
    """One episode's robot: drawn from the configured ranges, or the nominal one where randomisation is off."""
    ranges = config.randomization
    if not ranges.enabled:
        return nominal(config)
    kp, kd, strength, motor_friction, friction, mass, inertia, latency = jax.random.split(key, 8)
    dynamics = Dynamics(
        kp=_uniform(kp, ranges.kp),  # kp ~ U(40, 90)
        kd=_uniform(kd, ranges.kd),  # kd ~ U(0.4, 0.8)
        strength=_uniform(strength, ranges.motor_strength, (NJOINT,)),  # per motor ~ U(0.8, 1.2)
        motor_friction=_uniform(motor_friction, ranges.motor_friction),  # ~ U(0, 0.05)
        friction=_uniform(friction, ranges.friction),  # ~ U(0.5, 1.25)
        mass=_uniform(mass, ranges.mass),  # factor ~ U(0.8, 1.2)
        inertia=_uniform(inertia, ranges.inertia),  # factor ~ U(0.5, 1.5)
    )
    return Randomization(dynamics, _uniform(latency, ranges.latency))  # latency ~ U(0, 0.04) s
