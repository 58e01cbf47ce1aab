"""Mass matrix and bias forces of a quadruped, in closed form: what MuJoCo and MJX compute for any tree.

Each leg is reckoned in a frame of its own: at its hip joint, turned with the hip. There the hip turns about x, thigh
and calf about y, and the thigh's axis passes beside the origin along y, so that most products are with 0 or 1. Sums are
then carried over to the trunk. Composite rigid bodies and Newton-Euler: Featherstone, "Rigid Body Dynamics Algorithms"
(2008), chapters 5 and 6. Arrays have the N environments on their last axis, (4, N) over legs.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import rotations
from loco_mjx.physics.block_matrix import BlockMatrix, DofVector
from loco_mjx.physics.kinematics import Vector, column
from loco_mjx.physics.links import Links, of_link
from loco_mjx.physics.spatial import (
    Inertia,
    Motion,
    Twist,
    Wrench,
    add,
    beyond_joint,
    carried,
    cross,
    force_on,
    joined,
    joint_momentum,
    plus,
    shifted,
    torque_about_y,
    turned,
    turned_inertia,
)
from loco_mjx.physics.xla import FusionBarrier, add_up, total
from loco_mjx.robots import Robot

GRAVITY = 9.81  # m/s²; loco_mjx/physics/compiled.py refuses others


class _Turns(NamedTuple):
    """Sines and cosines of a leg's angles: hip, thigh, and thigh and calf together; each (4, N)."""

    sin: tuple[jax.Array, jax.Array, jax.Array]
    cos: tuple[jax.Array, jax.Array, jax.Array]


def _turns(qpos: jax.Array) -> _Turns:
    hip, thigh, calf = (qpos[7 + part :: 3] for part in range(3))  # (4, N) each
    angles = jp.stack([hip, thigh, thigh + calf])
    sin, cos = jp.sin(angles), jp.cos(angles)
    return _Turns((sin[0], sin[1], sin[2]), (cos[0], cos[1], cos[2]))


def _knee(robot: Robot, turns: _Turns) -> Vector:
    """In the leg's frame; so far aside are the shoulder and the whole lower leg."""
    length = np.float32(-robot.thigh_length)
    return (length * turns.sin[1], column(robot.thigh_offset, turns.sin[1]), length * turns.cos[1])  # type: ignore


def _bodies(robot: Robot, links: Links, turns: _Turns, mass: jax.Array, inertia: jax.Array) -> tuple[Inertia, ...]:
    """Hip, thigh and calf in the leg's frame."""
    hip, thigh, calf = (of_link(links, part, mass, inertia) for part in (1, 2, 3))
    thigh, calf = (turned_inertia(body, 1, turns.sin[i], turns.cos[i]) for i, body in ((1, thigh), (2, calf)))
    shoulder = (np.float32(0), column(robot.thigh_offset, turns.sin[1]), np.float32(0))
    return hip, shifted(thigh, shoulder), shifted(calf, _knee(robot, turns))  # type: ignore[arg-type]


def _places(robot: Robot, turns: _Turns) -> Vector:
    """Origins of the legs' frames in the trunk's."""
    return tuple(column([hip[i] for hip in robot.hips], turns.sin[0]) for i in range(3))  # type: ignore[return-value]


def _motions(robot: Robot, turns: _Turns, speeds: jax.Array, trunk: Motion) -> tuple[Motion, ...]:
    """Of hip, thigh and calf in the leg's frame, of the joints' speeds (12, N) and the motion of the trunk."""
    velocity, acceleration = trunk
    back = lambda vector: turned(vector, 0, -turns.sin[0], turns.cos[0])  # noqa: E731
    linear = add(velocity.linear, cross(velocity.angular, _places(robot, turns)))
    in_leg = Motion(
        Twist(back(velocity.angular), back(linear)), Twist(back(acceleration.angular), back(acceleration.linear))
    )
    hip = beyond_joint(in_leg, 0, speeds[0::3])
    thigh = beyond_joint(hip, 1, speeds[1::3])
    return hip, thigh, beyond_joint(thigh, 1, speeds[2::3], _knee(robot, turns))


class _Legs(NamedTuple):
    """What the legs add.

    Attributes:
        joints: (3, 3, 4, N) their blocks of the mass matrix.
        bias: (3, 4, N) of hip, thigh and calf, N m.
        inertia: of each whole leg, about the trunk's origin and along its axes, as all that follows.
        momenta: of each leg when its hip, its thigh or its calf turns at 1 rad/s.
        force: that moves each leg.
    """

    joints: jax.Array
    bias: jax.Array
    inertia: Inertia
    momenta: tuple[Wrench, ...]
    force: Wrench


def _symmetric(xx: Any, yy: Any, zz: Any, yz: Any, xz: Any, xy: Any) -> jax.Array:
    """A 3 × 3 matrix of its elements."""
    return jp.stack([jp.stack(row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))])


def _legs(robot: Robot, turns: _Turns, bodies: tuple[Inertia, ...], forces: list[Wrench]) -> _Legs:
    """All that matters of the legs, of their bodies and the forces on these in the legs' frames."""
    knee, place = _knee(robot, turns), _places(robot, turns)
    (sin, *_), (cos, *_) = turns
    hip, thigh, calf = bodies
    lower = joined(thigh, calf)
    leg = joined(hip, lower)
    f1, f2, f3 = joint_momentum(leg, 0), joint_momentum(lower, 1), joint_momentum(calf, 1, knee)
    joints = _symmetric(f1.torque[0], f2.torque[1], torque_about_y(f3, knee), f3.torque[1], f3.torque[0], f2.torque[0])
    of_lower = plus(forces[1], forces[2])
    whole = plus(forces[0], of_lower)
    bias = jp.stack([whole.torque[0], of_lower.torque[1], torque_about_y(forces[2], knee)])
    momenta = tuple(carried(momentum, place, 0, sin, cos) for momentum in (f1, f2, f3))
    inertia = shifted(turned_inertia(leg, 0, sin, cos), place)
    return _Legs(joints, bias, inertia, momenta, carried(whole, place, 0, sin, cos))


def _with_trunk(
    links: Links, axes: tuple[Vector, Vector, Vector], legs: _Legs, trunk: Inertia, force: Wrench
) -> tuple[BlockMatrix, DofVector]:
    """The whole of the trunk, what moves it, and its legs."""
    whole, force = joined(trunk, jax.tree.map(total, legs.inertia)), plus(force, jax.tree.map(total, legs.force))

    def world(vector: Vector) -> list[jax.Array]:
        return [add_up(axis[i] * part for axis, part in zip(axes, vector, strict=True)) for i in range(3)]

    (hx, hy, hz), none = whole.moment, jp.zeros_like(whole.moment[0])
    linear = np.eye(3, dtype=np.float32)[..., None] * whole.mass
    turning = jp.stack([jp.stack(world(v)) for v in ((none, -hz, hy), (hz, none, -hx), (-hy, hx, none))])
    above = jp.concatenate([linear, jp.swapaxes(turning, 0, 1)], axis=1)
    beneath = jp.concatenate([turning, _symmetric(*whole.diagonal, *whole.products)], axis=1)
    coupling = jp.stack([jp.stack([*world(momentum.force), *momentum.torque]) for momentum in legs.momenta])
    base = jp.concatenate([above, beneath]) + links.armature[0]
    qfrc_bias = DofVector(jp.stack([*world(force.force), *force.torque]), legs.bias)
    return BlockMatrix(base, coupling, legs.joints + links.armature[1]), qfrc_bias


def qM_and_qfrc_bias(
    robot: Robot,
    links: Links,
    barrier: FusionBarrier,
    qpos: jax.Array,
    qvel: jax.Array,
    mass: jax.Array,
    inertia: jax.Array,
) -> tuple[BlockMatrix, DofVector]:
    """MuJoCo's mass matrix, and its bias: Coriolis, centrifugal and gravity forces.

    Args:
        robot: whose.
        links: its masses.
        barrier: what keeps XLA from computing things again.
        qpos: (19, N).
        qvel: (18, N).
        mass: (N,) factor on all masses.
        inertia: (N,) factor on all bodies' rotational inertias.
    """
    axes = rotations.axes(qpos[3:7], jp)  # the trunk's, in the world
    angular: Vector = (qvel[3], qvel[4], qvel[5])
    weight: Vector = tuple(GRAVITY * axis[2] for axis in axes)  # type: ignore[assignment]
    # To who flies along nothing is different: the trunk's own velocity is left out.
    still = (jp.zeros_like(qvel[0]),) * 3
    trunk, motion = of_link(links, 0, mass, inertia), Motion(Twist(angular, still), Twist(still, weight))

    turns = barrier(_turns, qpos)
    bodies = barrier(lambda turns: _bodies(robot, links, turns, mass, inertia), turns)
    motions = barrier(lambda turns: _motions(robot, turns, qvel[6:], motion), turns)
    forces = barrier(lambda *given: [force_on(*each) for each in zip(*given, strict=True)], bodies, motions)
    legs = barrier(partial(_legs, robot), turns, bodies, forces)
    return barrier(partial(_with_trunk, links, axes), legs, trunk, force_on(trunk, motion))
