"""Constraints from the contact slots and the joint limits, as MuJoCo makes them.

Formulas: MuJoCo's documentation, "Computation", "Constraint model" (pyramidal friction cones). Arrays have the N
environments on their last axis, (4, N) over legs.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics import block_matrix
from loco_mjx.physics.block_matrix import BASE, JOINTS, LEGS, DofVector
from loco_mjx.physics.collision import ContactSlots
from loco_mjx.physics.efc import Constraints
from loco_mjx.physics.kinematics import Pose, Vector, calf_centers, column, trunk_centers
from loco_mjx.physics.model import PhysicsModel, SolverParameters
from loco_mjx.physics.shapes import Planes
from loco_mjx.physics.spatial import cross
from loco_mjx.physics.xla import add_up
from loco_mjx.robots import Robot


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
    return first, cross(normal, first)


def _impedance(parameters: SolverParameters, pos: jax.Array) -> jax.Array:
    """MuJoCo's impedance d(pos) of a constraint, for its sigmoid of power 2."""
    x = jp.minimum(jp.abs(pos) * (1.0 / parameters.width), 1.0)
    mid = parameters.midpoint
    # y(x) = x² / mid below the midpoint, 1 − (1 − x)² / (1 − mid) above it
    y = jp.where(x < mid, x * x / mid, 1.0 - (1.0 - x) * (1.0 - x) / (1.0 - mid))
    return parameters.dmin + y * (parameters.dmax - parameters.dmin)  # d = dmin + y (dmax − dmin)


def _D_and_aref(
    parameters: SolverParameters, pos: jax.Array, diagApprox: jax.Array | np.ndarray
) -> tuple[jax.Array, jax.Array]:
    """D, 0 unless `pos` is negative, and aref of a constraint whose velocity is 0.

    Args:
        parameters: the constraint's solref and solimp.
        pos: its distance, m or rad.
        diagApprox: MuJoCo's approximation of the diagonal of J M⁻¹ Jᵀ, from the bodies' inverse weights.
    """
    d = _impedance(parameters, pos)
    D = d / (diagApprox * (1.0 - d))  # R = diagApprox (1 − d) / d, D = 1 / R
    return jp.where(pos < 0.0, D, 0.0), -parameters.k * d * pos  # aref = −b vel − k d pos


def _base_J(pose: Pose, point: Vector, direction: Vector) -> list[jax.Array]:
    """J in the base's 6 degrees of freedom, of the velocity of points along directions."""
    moment = cross(_sub(point, pose.origin), direction)
    return [*direction, *(_dot(axis, moment) for axis in (pose.forward, pose.left, pose.up))]


def _joint_J(pose: Pose, point: Vector, direction: Vector) -> list[jax.Array]:
    """J in a leg's 3 joints, of the velocity along directions of points that move with its calf."""
    pairs = ((pose.forward, pose.hip), (pose.side, pose.shoulder), (pose.side, pose.knee))
    return [_dot(axis, cross(_sub(point, anchor), direction)) for axis, anchor in pairs]


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


def _leg_rows(robot: Robot, pose: Pose, slots: ContactSlots) -> _LegRows:
    count = len(slots.feet)
    frictional, frictionless = (*slots.feet, slots.knees[0]), (slots.hips, slots.calves, *slots.knees[1:])
    others = len(frictionless) - 2
    centers = (*[pose.foot] * count, pose.knee, pose.shoulder, calf_centers(pose), *[pose.knee] * others)
    foot, hip, knee, calf = robot.leg_radii
    radii = (*[foot] * count, knee, hip, calf, *[knee] * others)
    points = [
        _contact_point(c, plane, r) for c, plane, r in zip(centers, frictional + frictionless, radii, strict=True)
    ]
    frames = [tangents(plane.normal) for plane in frictional]
    directions = [plane.normal for plane in frictional] + [f[0] for f in frames] + [f[1] for f in frames]
    directions += [plane.normal for plane in frictionless]
    rows = points[: len(frictional)] * 3 + points[len(frictional) :]
    distance = jp.stack([plane.distance for plane in frictional + frictionless])
    return _LegRows(distance, _stacked(rows), _stacked(directions))


def _legs(
    model: PhysicsModel, pose: Pose, qvel: DofVector, legs: _LegRows, friction: jax.Array, mass: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """J, aref and D of the legs' contacts; see efc.Constraints."""
    rows, contacts = legs.point[0].shape[0], legs.distance.shape[0]
    slots = (rows - contacts) // 2
    # A hip's sphere moves with the hip joint only.
    beyond_hip = (np.arange(rows) != 3 * slots).astype(np.float32).reshape(-1, 1, 1)
    hip, thigh, calf = _joint_J(pose, legs.point, legs.direction)
    base = _base_J(pose, legs.point, legs.direction)
    J = jp.stack([*base, hip, thigh * beyond_hip, calf * beyond_hip])
    # Every edge of a pyramid has the diagApprox of its normal times 2 mu² (1 + mu²): MuJoCo's own approximation.
    edge = 2.0 * friction * friction * (1.0 + friction * friction) / mass
    foot, shoulder, knee, shaft = model.sphere_invweight[: 4 * LEGS].reshape(4, 1, LEGS, 1)
    frictional = np.concatenate([foot] * (slots - 1) + [knee])
    frictional_D, frictional_aref = _D_and_aref(model.contact_parameters, legs.distance[:slots], frictional * edge)
    frictionless = np.concatenate([shoulder, shaft] + [knee] * (contacts - slots - 2))
    frictionless_D, frictionless_aref = _D_and_aref(
        model.contact_parameters, legs.distance[slots:], frictionless / mass
    )
    vel = add_up(J[i] * qvel.base[i] for i in range(BASE))
    vel = vel + add_up(J[BASE + j] * qvel.joints[j] for j in range(JOINTS))
    damped = -model.contact_parameters.b * vel
    aref = [damped[:slots] + frictional_aref, damped[slots : 3 * slots], damped[3 * slots :] + frictionless_aref]
    return J, jp.concatenate(aref), jp.concatenate([frictional_D, frictionless_D])


def _trunk(
    model: PhysicsModel, pose: Pose, qvel: DofVector, plane: Planes, mass: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """J, aref and D of the trunk's contacts."""
    radii = column(model.robot.radii[4 * LEGS :], plane.distance)
    point = _contact_point(trunk_centers(model.robot, pose), plane, radii)
    J = jp.stack(_base_J(pose, point, plane.normal))
    invweight = column(model.sphere_invweight[4 * LEGS :], plane.distance) / mass
    D, aref = _D_and_aref(model.contact_parameters, plane.distance, invweight)
    vel = add_up(J[i] * qvel.base[i] for i in range(BASE))
    return J, aref - model.contact_parameters.b * vel, D


def _limits(model: PhysicsModel, angles: jax.Array, speeds: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """J (±1), aref and D of the joint limits, each (3, 4, N), like the arguments."""
    shape = lambda values: np.asarray(values, np.float32).reshape(LEGS, JOINTS).T[:, :, None]  # noqa: E731
    above, below = angles - shape(model.robot.lower), shape(model.robot.upper) - angles
    J = jp.where(above < below, 1.0, -1.0).astype(angles.dtype)
    D, aref = _D_and_aref(model.limit_parameters, jp.minimum(above, below), shape(model.joint_invweight))
    return J, aref - model.limit_parameters.b * J * speeds, D


def constraints(
    model: PhysicsModel,
    pose: Pose,
    qpos: jax.Array,
    qvel: jax.Array,
    slots: ContactSlots,
    friction: jax.Array,
    mass: jax.Array,
) -> Constraints:
    """J, aref and D of all constraints.

    Args:
        model: the physics.
        pose: where the robot is.
        qpos: (19, N).
        qvel: (18, N).
        slots: what the spheres may touch.
        friction: (N,) coefficient of feet and knees.
        mass: (N,) factor on the robot's mass.
    """
    velocities = block_matrix.split(qvel)
    angles = jp.swapaxes(qpos[7:].reshape(LEGS, JOINTS, -1), 0, 1)
    legs = _legs(model, pose, velocities, _leg_rows(model.robot, pose, slots), friction, mass)
    trunk = _trunk(model, pose, velocities, slots.trunk, mass)
    return Constraints(*legs, friction, *trunk, *_limits(model, angles, velocities.joints))
