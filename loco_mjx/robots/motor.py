"""What the motors are told, and their law: a PD controller in each joint, clipped to what the motor can."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import jax
    import numpy as np


class MotorCommand(NamedTuple):
    """What motors like Unitree's are told: torque + kp (angles − q) + kd (velocities − q̇), each (12,), SI."""

    angles: Any
    velocities: Any
    kp: Any
    kd: Any
    torque: Any


def motor_torque(
    target: jax.Array | np.ndarray,
    angle: jax.Array | np.ndarray,
    velocity: jax.Array | np.ndarray,
    kp: jax.Array | float,
    kd: jax.Array | float,
    limit: np.ndarray | float,
    strength: jax.Array | float = 1.0,
    friction: jax.Array | float = 0.0,
) -> jax.Array:
    """Torques strength · (kp (target − angle) − kd velocity) − friction · velocity, clipped.

    Args:
        target: (12, ...) desired joint angles, rad.
        angle: (12, ...) joint angles, rad.
        velocity: (12, ...) joint velocities, rad/s.
        kp: proportional gain, N·m/rad.
        kd: derivative gain, N·m·s/rad.
        limit: N·m, of all motors or of each, to broadcast against the angles.
        strength: factor on the controller's torque, scalar or of each motor.
        friction: viscous friction of the motor, N·m·s/rad.

    Returns:
        (12, ...) torques in N·m, within ±limit.
    """
    import jax.numpy as jp  # here, so that robots can be read without JAX

    torque = strength * (kp * (target - angle) - kd * velocity) - friction * velocity
    return jp.clip(torque, -limit, limit)
