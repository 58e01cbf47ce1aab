"""The Unitree A1: joint names and order, default pose, limits, gains, and the motor law.

Figures: Unitree's A1 description (masses, lengths, limits) and the LocoTransformer paper, appendix A (gains, rates).
Units are SI; angles in radians. Joints and actuators come as FR, FL, RR, RL, each (hip, thigh, calf), everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jax

LEGS: tuple[str, ...] = ("FR", "FL", "RR", "RL")
PARTS: tuple[str, ...] = ("hip", "thigh", "calf")
JOINTS: tuple[str, ...] = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)

DEFAULT_POSE: tuple[float, ...] = (0.0, 0.9, -1.8) * len(LEGS)
JOINT_LOWER: tuple[float, ...] = (-0.802851, -1.0472, -2.69653) * len(LEGS)
JOINT_UPPER: tuple[float, ...] = (0.802851, 4.18879, -0.916298) * len(LEGS)
TORQUE_LIMIT = 33.5  # N·m
KP = 40.0  # N·m/rad
KD = 0.6  # N·m·s/rad

# Leg geometry, m. Signs: front is +x, left is +y.
HIP_X = 0.183
HIP_Y = 0.047
THIGH_OFFSET = 0.08505
LINK_LENGTH = 0.2  # thigh and calf alike
FOOT_RADIUS = 0.02
CAMERA_OFFSET = 0.2309  # depth camera ahead of the trunk origin, along trunk x
# Base height with the feet resting on flat ground in the default pose: 2 · 0.2 · cos(0.9) + foot radius.
STAND_HEIGHT = 0.2686

CONTROL_DT = 0.04  # 25 Hz policy
PHYSICS_DT = 0.0025  # 400 Hz PD
SUBSTEPS = 16  # physics steps in a control step
GRAVITY = 9.81


def motor_torque(
    target: jax.Array,
    angle: jax.Array,
    velocity: jax.Array,
    kp: jax.Array | float = KP,
    kd: jax.Array | float = KD,
    strength: jax.Array | float = 1.0,
    friction: jax.Array | float = 0.0,
) -> jax.Array:
    """Torque of the 12 motors: strength · (kp (target − angle) − kd velocity) − friction · velocity, clipped.

    Args:
        target: (12,) desired joint angles, rad.
        angle: (12,) joint angles, rad.
        velocity: (12,) joint velocities, rad/s.
        kp: proportional gain, N·m/rad.
        kd: derivative gain, N·m·s/rad.
        strength: factor on the controller's torque, scalar or (12,).
        friction: viscous friction of the motor, N·m·s/rad.

    Returns:
        (12,) torques in N·m, within ±TORQUE_LIMIT.
    """
    import jax.numpy as jp  # here, so that the constants above can be read without JAX

    torque = strength * (kp * (target - angle) - kd * velocity) - friction * velocity
    return jp.clip(torque, -TORQUE_LIMIT, TORQUE_LIMIT)
