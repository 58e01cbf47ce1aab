"""The rows of MuJoCo's constraint problem for the A1: values along them, the forces they make, their curvature.

Every contact moves the base and one leg only (see arrow.py), so rows are kept by leg.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics.arrow import BASE, JOINTS, LEGS, Arrow, Motion
from loco_mjx.physics.stage import Stage, add_up


class Constraints(NamedTuple):
    """Everything that pushes. Rows with weight 0 are out of contact.

    A leg has S slots with friction, its foot's and its knee's nearest, and K without. Its P rows are S normals, S first
    tangents, S second tangents, then the normals of the K: the hip's, the calf's, the knee's others. P = 3 S + K.

    Attributes:
        legs: (9, P, 4, N) Jacobian of the legs' contacts: in the base's degrees of freedom, then in the leg's joints.
        leg_reference: (P, 4, N) reference acceleration r in each direction.
        leg_weight: (S + K, 4, N) D, of every edge of a friction pyramid, and of what has no friction.
        friction: (N,) coefficient of feet and knees.
        trunk: (6, T, N) Jacobian of the trunk's contacts, without friction.
        trunk_reference: (T, N).
        trunk_weight: (T, N).
        limit_sign: (3, 4, N) Jacobian of the joint limits, each in its own joint, ±1.
        limit_reference: (3, 4, N).
        limit_weight: (3, 4, N).
    """

    legs: jax.Array
    leg_reference: jax.Array
    leg_weight: jax.Array
    friction: jax.Array
    trunk: jax.Array
    trunk_reference: jax.Array
    trunk_weight: jax.Array
    limit_sign: jax.Array
    limit_reference: jax.Array
    limit_weight: jax.Array

    @property
    def slots(self) -> int:
        """S, contact slots with friction per leg."""
        return (self.legs.shape[1] - self.leg_weight.shape[0]) // 2


class Values(NamedTuple):
    """A number for each row of the constraints: legs (P, 4, N), trunk (T, N), limits (3, 4, N)."""

    legs: jax.Array
    trunk: jax.Array
    limits: jax.Array


class Push(NamedTuple):
    """The constraints at a point: minus their forces, and what the forces' derivatives are made of.

    Attributes:
        force: per row; with friction, in each direction.
        legs: weights of the active edges, as in :func:`_edges`.
        trunk: (T, N) weights of the active rows.
        limits: (3, 4, N).
    """

    force: Values
    legs: list[jax.Array]
    trunk: jax.Array
    limits: jax.Array


def product(constraints: Constraints, vector: Motion) -> Values:
    """Jacobian times vector."""
    legs = add_up(constraints.legs[i] * vector.base[i] for i in range(BASE))
    legs = legs + add_up(constraints.legs[BASE + j] * vector.joints[j] for j in range(JOINTS))
    trunk = add_up(constraints.trunk[i] * vector.base[i] for i in range(BASE))
    return Values(legs, trunk, constraints.limit_sign * vector.joints)


def transposed(constraints: Constraints, values: Values) -> Motion:
    """Transposed Jacobian times a value per row."""
    legs = add_up(constraints.legs[:, p] * values.legs[p] for p in range(values.legs.shape[0]))  # (9, 4, N)
    trunk = add_up(constraints.trunk[:, t] * values.trunk[t] for t in range(values.trunk.shape[0]))
    base = trunk + add_up(legs[:BASE, leg] for leg in range(LEGS))
    return Motion(base, legs[BASE:] + constraints.limit_sign * values.limits)


def _edges(constraints: Constraints, legs: jax.Array) -> list[jax.Array]:
    """From values (P, 4, N) in directions: of the four edges of the pyramids, each (S, 4, N), and the rest's."""
    slots = constraints.slots
    normal, rest = legs[:slots], legs[3 * slots :]
    first, second = (constraints.friction * legs[i * slots : (i + 1) * slots] for i in (1, 2))
    return [normal + first, normal - first, normal + second, normal - second, rest]


def _edge_weights(constraints: Constraints) -> list[jax.Array]:
    """D of what :func:`_edges` returns."""
    slots = constraints.slots
    return [constraints.leg_weight[:slots]] * 4 + [constraints.leg_weight[slots:]]


def push(constraints: Constraints, residual: Values) -> Push:
    """The forces where rows' J a − r is `residual`, and their derivatives."""
    edges, mu = _edges(constraints, residual.legs), constraints.friction
    weights = _edge_weights(constraints)
    active = [jp.where(edge < 0.0, weight, 0.0) for edge, weight in zip(edges, weights, strict=True)]
    trunk = jp.where(residual.trunk < 0.0, constraints.trunk_weight, 0.0)
    limits = jp.where(residual.limits < 0.0, constraints.limit_weight, 0.0)
    up, down, left, right, rest = (weight * edge for edge, weight in zip(edges, active, strict=True))
    in_directions = [up + down + left + right, mu * (up - down), mu * (left - right), rest]
    force = Values(jp.concatenate(in_directions), trunk * residual.trunk, limits * residual.limits)
    return Push(force, active, trunk, limits)


def _stiff_rows(constraints: Constraints, push: Push) -> jax.Array:
    """(9, P, 4, N) derivative of the legs' forces times the Jacobian. The two tangents of a pyramid do not mix."""
    slots, mu = constraints.slots, constraints.friction
    normal, first, second = (constraints.legs[:, i * slots : (i + 1) * slots] for i in range(3))
    up, down, left, right, rest = push.legs
    by_first, by_second = mu * (up - down), mu * (left - right)
    rows = [
        (up + down + left + right) * normal + by_first * first + by_second * second,
        by_first * normal + mu * mu * (up + down) * first,
        by_second * normal + mu * mu * (left + right) * second,
        rest * constraints.legs[:, 3 * slots :],
    ]
    return jp.concatenate(rows, axis=1)


def hessian(stage: Stage, inertia: Arrow, constraints: Constraints, pushed: Push) -> Arrow:
    """The inertia + Jᵀ · (derivative of the forces) · J."""
    stiff = stage(_stiff_rows, constraints, pushed)
    weighted = constraints.trunk * pushed.trunk
    trunk = add_up(constraints.trunk[:, None, t] * weighted[None, :, t] for t in range(weighted.shape[1]))

    # Row by row in a loop, so that the result is there before the elimination takes it apart.
    def row(_: None, jacobian: jax.Array) -> tuple[None, jax.Array]:
        return None, add_up(jacobian[p] * stiff[:, p] for p in range(stiff.shape[1]))

    legs = jax.lax.scan(row, None, constraints.legs)[1]  # (9, 9, 4, N)
    limits = np.eye(JOINTS, dtype=np.float32)[:, :, None, None] * pushed.limits
    return Arrow(
        inertia.base + trunk + add_up(legs[:BASE, :BASE, leg] for leg in range(LEGS)),
        inertia.coupling + legs[BASE:, :BASE],
        inertia.joints + legs[BASE:, BASE:] + limits,
    )


def flat(constraints: Constraints, values: Values) -> jax.Array:
    """Values of all edges and rows in one (rows, N) array."""
    parts = [*_edges(constraints, values.legs), values.limits, values.trunk]
    return jp.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])


def flat_weights(constraints: Constraints) -> jax.Array:
    """D in the order of :func:`flat`."""
    parts = [*_edge_weights(constraints), constraints.limit_weight, constraints.trunk_weight]
    return jp.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])
