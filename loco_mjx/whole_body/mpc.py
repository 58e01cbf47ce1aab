"""The quadratic program of the stance forces: convex model predictive control of a single rigid body.

Di Carlo et al., "Dynamic Locomotion in the MIT Cheetah 3 Through Convex Model-Predictive Control", IROS 2018. In the
level frame (z up, x the heading) with small roll and pitch, the trunk's six accelerations are linear in the forces and
its motion is six double integrators, so that over the horizon

    cost = ½ dᵀ S d + sᵀ d + ½ R |f|²,    d_k = G_k f_k − (0, 0, 0, 0, 0, g)

where S holds one horizon × horizon block for each degree of freedom and depends on nothing but weights and time step.
Degrees of freedom come as roll, pitch, yaw, x, y, z everywhere.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from loco_mjx.whole_body.arrays import Array, skew, space
from loco_mjx.whole_body.config import Mpc
from loco_mjx.whole_body.legs import Body

GRAVITY = 9.81  # m/s²


class Problem(NamedTuple):
    """One quadratic program.

    Attributes:
        gradient: (6, horizon) s, of the cost by the accelerations.
        effect: (6, 4, 3) G, accelerations by the feet's forces in the level frame, 1/kg and 1/(kg m).
        pushes: (horizon, 4) bool, which feet push; the others' forces are zero.
        weight: of the robot, N: the scale of the limits.
    """

    gradient: Array
    effect: Array
    pushes: Array
    weight: Array


class Plan(NamedTuple):
    """What is constant.

    Attributes:
        position: (horizon, horizon) positions by accelerations, s².
        velocity: (horizon, horizon) velocities by accelerations, s.
        times: (horizon,) of the steps, s.
        curvature: (6, horizon, horizon) S.
    """

    position: np.ndarray
    velocity: np.ndarray
    times: np.ndarray
    curvature: np.ndarray


@functools.cache
def plan(mpc: Mpc) -> Plan:
    """What is constant in every program of a configuration."""
    steps = np.arange(mpc.horizon)
    since = steps[:, None] + 1 - steps[None, :]  # steps between an acceleration's beginning and a planned state
    velocity = np.where(since > 0, mpc.dt, 0.0)
    position = np.where(since > 0, mpc.dt**2 * (since - 0.5), 0.0)
    stiff, damp = np.array(mpc.attitude + mpc.position), np.array(mpc.spin + mpc.velocity)
    curvature = np.multiply.outer(stiff, position.T @ position) + np.multiply.outer(damp, velocity.T @ velocity)
    return Plan(position, velocity, (steps + 1) * mpc.dt, curvature)


def gradient(mpc: Mpc, pose: Array, rates: Array, command: Array, height: float) -> Array:
    """(6, horizon) s: the cost's slope by the accelerations, where there are none but what carries the weight.

    Args:
        mpc: weights.
        pose: (6,) roll, pitch, 0, 0, 0 and height above the feet, rad and m.
        rates: (6,) angular velocity and velocity of the trunk in the level frame, rad/s and m/s.
        command: (2,) speed ahead and yaw rate.
        height: that is wanted, m.
    """
    xp, kind, fixed = space(pose), pose.dtype, plan(mpc)
    zero = xp.zeros_like(command[0])
    speed = rates - xp.stack([zero, zero, command[1], command[0], zero, zero])
    off = (pose - np.array([0, 0, 0, 0, 0, height], kind))[:, None] + speed[:, None] * fixed.times.astype(kind)
    stiff = np.array(mpc.attitude + mpc.position, kind)[:, None]
    damp = np.array(mpc.spin + mpc.velocity, kind)[:, None]
    return stiff * (off @ fixed.position.astype(kind)) + damp * speed[:, None] * fixed.velocity.sum(axis=0).astype(kind)


def effect(body: Body, attitude: Array, feet: Array) -> Array:
    """(6, 4, 3) accelerations of the trunk in the level frame by the forces on the feet."""
    xp, kind = space(feet), feet.dtype
    arms = (feet - np.asarray(body.center, kind)) @ attitude.T
    inverse = attitude @ np.linalg.inv(body.inertia).astype(kind) @ attitude.T
    turning = xp.einsum("ij,ljk->ilk", inverse, skew(arms))
    pushing = np.broadcast_to(np.eye(3, dtype=kind)[:, None, :] / np.asarray(body.mass, kind), (3, 4, 3))
    return xp.concatenate([turning, pushing])
