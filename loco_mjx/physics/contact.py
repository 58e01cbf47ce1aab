"""Constraints from the contact slots and the joint limits, as MuJoCo makes them.

Formulas: MuJoCo's documentation, "Computation", "Constraint model" (pyramidal friction cones). Arrays have the N
environments on their last axis, (4, N) over legs.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics import arrow
from loco_mjx.physics.arrow import BASE, JOINTS, LEGS, Motion
from loco_mjx.physics.kinematics import Pose, Vector, calf_centers, column, trunk_centers
from loco_mjx.physics.model import PhysicsModel, Softness
from loco_mjx.physics.rows import Constraints
from loco_mjx.physics.slots import Planes, Slots
from loco_mjx.physics.stage import add_up
from loco_mjx.robots import Robot


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> jax.Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sub(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def tangents(normal: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors that complete a normal to a frame, chosen as MuJoCo chooses them (from y, or z if steep)."""
    level = (jp.abs(normal[1]) < 0.5).astype(normal[1].dtype)
    along: Vector = (jp.zeros_like(level), level, 1.0 - level)
    off = _dot(along, normal)
    x, y, z = (a - off * n for a, n in zip(along, normal, strict=True))
    scale = jax.lax.rsqrt(x * x + y * y + z * z)
    first = (x * scale, y * scale, z * scale)
    return first, _cross(normal, first)


def _impedance(softness: Softness, distance: jax.Array) -> jax.Array:
    """MuJoCo's impedance d(r) of a constraint violated by `distance`, for its sigmoid of power 2."""
    x = jp.minimum(jp.abs(distance) * (1.0 / softness.width), 1.0)
    mid = softness.middle
    rise = jp.where(x < mid, x * x / mid, 1.0 - (1.0 - x) * (1.0 - x) / (1.0 - mid))
    return softness.lowest + rise * (softness.highest - softness.lowest)


def _weight_and_pull(
    softness: Softness, distance: jax.Array, invweight: jax.Array | np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """D (0 unless `distance` is negative) and the reference acceleration of a constraint at rest."""
    impedance = _impedance(softness, distance)
    weight = impedance / (invweight * (1.0 - impedance))
    return jp.where(distance < 0.0, weight, 0.0), -softness.stiffness * impedance * distance


def _base_rows(pose: Pose, point: Vector, direction: Vector) -> list[jax.Array]:
    """Jacobian in the base's 6 degrees of freedom of points' velocities along directions."""
    moment = _cross(_sub(point, pose.origin), direction)
    return [*direction, *(_dot(axis, moment) for axis in (pose.forward, pose.left, pose.up))]


def _joint_rows(pose: Pose, point: Vector, direction: Vector) -> list[jax.Array]:
    """Jacobian in a leg's 3 joints of the velocities along directions of points that move with its calf."""
    pairs = ((pose.forward, pose.hip), (pose.side, pose.shoulder), (pose.side, pose.knee))
    return [_dot(axis, _cross(_sub(point, anchor), direction)) for axis, anchor in pairs]


def _contact_point(center: Vector, plane: Planes, radius: np.ndarray | float) -> Vector:
    """Halfway between the sphere's surface and the plane."""
    depth = radius + 0.5 * plane.distance
    x, y, z = (c - n * depth for c, n in zip(center, plane.normal, strict=True))
    return x, y, z


def _stacked(vectors: list[Vector]) -> Vector:
    x, y, z = (jp.stack([v[i] for v in vectors]) for i in range(3))
    return x, y, z


class _LegRows(NamedTuple):
    """Contacts of the legs: S with friction, of the feet's slots and the knees' nearest, then K without.

    The K are the hips', the calves' and the knees' others.

    Attributes:
        distance: (S + K, 4, N).
        point: x, y, z of the contacts, each (P, 4, N), for each row of the Jacobian.
        direction: of each row, likewise.
    """

    distance: jax.Array
    point: Vector
    direction: Vector


def _leg_rows(robot: Robot, pose: Pose, slots: Slots) -> _LegRows:
    count = len(slots.feet)
    rough, smooth = (*slots.feet, slots.knees[0]), (slots.hips, slots.calves, *slots.knees[1:])
    others = len(smooth) - 2
    centers = (*[pose.foot] * count, pose.knee, pose.shoulder, calf_centers(pose), *[pose.knee] * others)
    foot, hip, knee, calf = robot.leg_radii
    radii = (*[foot] * count, knee, hip, calf, *[knee] * others)
    points = [_contact_point(c, plane, r) for c, plane, r in zip(centers, rough + smooth, radii, strict=True)]
    frames = [tangents(plane.normal) for plane in rough]
    directions = [plane.normal for plane in rough] + [f[0] for f in frames] + [f[1] for f in frames]
    directions += [plane.normal for plane in smooth]
    rows = points[: len(rough)] * 3 + points[len(rough) :]
    distance = jp.stack([plane.distance for plane in rough + smooth])
    return _LegRows(distance, _stacked(rows), _stacked(directions))


def _legs(
    model: PhysicsModel, pose: Pose, velocity: Motion, legs: _LegRows, friction: jax.Array, mass: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Jacobian, reference and weight of the legs' contacts; see rows.Constraints."""
    rows, contacts = legs.point[0].shape[0], legs.distance.shape[0]
    slots = (rows - contacts) // 2
    # A hip's sphere moves with the hip joint only.
    beyond_hip = (np.arange(rows) != 3 * slots).astype(np.float32).reshape(-1, 1, 1)
    hip, thigh, calf = _joint_rows(pose, legs.point, legs.direction)
    base = _base_rows(pose, legs.point, legs.direction)
    jacobian = jp.stack([*base, hip, thigh * beyond_hip, calf * beyond_hip])
    # As in MuJoCo, every edge of a pyramid has this times its normal's inverse weight.
    edge = 2.0 * friction * friction * (1.0 + friction * friction) / mass
    foot, shoulder, knee, shaft = model.sphere_invweight[: 4 * LEGS].reshape(4, 1, LEGS, 1)
    rough = np.concatenate([foot] * (slots - 1) + [knee])
    rough_weight, rough_pull = _weight_and_pull(model.softness, legs.distance[:slots], rough * edge)
    smooth = np.concatenate([shoulder, shaft] + [knee] * (contacts - slots - 2))
    smooth_weight, smooth_pull = _weight_and_pull(model.softness, legs.distance[slots:], smooth / mass)
    speed = add_up(jacobian[i] * velocity.base[i] for i in range(BASE))
    speed = speed + add_up(jacobian[BASE + j] * velocity.joints[j] for j in range(JOINTS))
    damped = -model.softness.damping * speed
    reference = [damped[:slots] + rough_pull, damped[slots : 3 * slots], damped[3 * slots :] + smooth_pull]
    return jacobian, jp.concatenate(reference), jp.concatenate([rough_weight, smooth_weight])


def _trunk(
    model: PhysicsModel, pose: Pose, velocity: Motion, plane: Planes, mass: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Jacobian, reference and weight of the trunk's contacts."""
    point = _contact_point(
        trunk_centers(model.robot, pose), plane, column(model.robot.radii[4 * LEGS :], plane.distance)
    )
    jacobian = jp.stack(_base_rows(pose, point, plane.normal))
    invweight = column(model.sphere_invweight[4 * LEGS :], plane.distance) / mass
    weight, pull = _weight_and_pull(model.softness, plane.distance, invweight)
    speed = add_up(jacobian[i] * velocity.base[i] for i in range(BASE))
    return jacobian, pull - model.softness.damping * speed, weight


def _limits(model: PhysicsModel, angles: jax.Array, speeds: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sign, reference and weight of the joint limits, each (3, 4, N), like the arguments."""
    shape = lambda values: np.asarray(values, np.float32).reshape(LEGS, JOINTS).T[:, :, None]  # noqa: E731
    above, below = angles - shape(model.robot.lower), shape(model.robot.upper) - angles
    sign = jp.where(above < below, 1.0, -1.0).astype(angles.dtype)
    weight, pull = _weight_and_pull(model.limit_softness, jp.minimum(above, below), shape(model.joint_invweight))
    return sign, pull - model.limit_softness.damping * sign * speeds, weight


def constraints(
    model: PhysicsModel,
    pose: Pose,
    qpos: jax.Array,
    qvel: jax.Array,
    slots: Slots,
    friction: jax.Array,
    mass: jax.Array,
) -> Constraints:
    """All constraints.

    Args:
        model: the physics.
        pose: where the robot is.
        qpos: (19, N).
        qvel: (18, N).
        slots: what the spheres may touch.
        friction: (N,) coefficient of feet and knees.
        mass: (N,) factor on the robot's mass.
    """
    velocity = arrow.split(qvel)
    angles = jp.swapaxes(qpos[7:].reshape(LEGS, JOINTS, -1), 0, 1)
    legs = _legs(model, pose, velocity, _leg_rows(model.robot, pose, slots), friction, mass)
    trunk = _trunk(model, pose, velocity, slots.trunk, mass)
    return Constraints(*legs, friction, *trunk, *_limits(model, angles, velocity.joints))
