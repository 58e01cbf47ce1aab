"""MuJoCo's efc rows of a quadruped: J times a vector, the forces of the rows, their part of the Hessian.

Every contact moves the base and one leg only (see block_matrix.py), so rows are kept by leg.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics.block_matrix import BASE, JOINTS, LEGS, BlockMatrix, DofVector
from loco_mjx.physics.xla import FusionBarrier, add_up


class Constraints(NamedTuple):
    """J, aref and D of every constraint. A row whose D is 0 is out of contact.

    A leg has S slots with friction, its foot's and its knee's nearest, and K without. Its P rows are S normals, S first
    tangents, S second tangents, then the normals of the K: the hip's, the calf's, the knee's others. P = 3 S + K.

    Attributes:
        leg_J: (9, P, 4, N) of the legs' contacts: in the base's degrees of freedom, then in the leg's joints.
        leg_aref: (P, 4, N) in each direction.
        leg_D: (S + K, 4, N) of every edge of a friction pyramid, and of what has no friction.
        friction: (N,) coefficient of feet and knees.
        trunk_J: (6, T, N) of the trunk's contacts, without friction.
        trunk_aref: (T, N).
        trunk_D: (T, N).
        limit_J: (3, 4, N) of the joint limits, each in its own joint, ±1.
        limit_aref: (3, 4, N).
        limit_D: (3, 4, N).
    """

    leg_J: jax.Array
    leg_aref: jax.Array
    leg_D: jax.Array
    friction: jax.Array
    trunk_J: jax.Array
    trunk_aref: jax.Array
    trunk_D: jax.Array
    limit_J: jax.Array
    limit_aref: jax.Array
    limit_D: jax.Array

    @property
    def slots(self) -> int:
        """S, contact slots with friction per leg."""
        return (self.leg_J.shape[1] - self.leg_D.shape[0]) // 2


class Values(NamedTuple):
    """A number for each row of the constraints: legs (P, 4, N), trunk (T, N), limits (3, 4, N)."""

    legs: jax.Array
    trunk: jax.Array
    limits: jax.Array


class ConstraintUpdate(NamedTuple):
    """What MuJoCo's mj_constraintUpdate computes at a qacc: minus efc_force, and D of the active rows.

    Attributes:
        force: −efc_force per row; with friction, in each direction.
        legs: D of the active edges, as in :func:`_edges`.
        trunk: (T, N) D of the active rows.
        limits: (3, 4, N).
    """

    force: Values
    legs: list[jax.Array]
    trunk: jax.Array
    limits: jax.Array


def mul_J(constraints: Constraints, vector: DofVector) -> Values:
    """J times vector."""
    legs = add_up(constraints.leg_J[i] * vector.base[i] for i in range(BASE))
    legs = legs + add_up(constraints.leg_J[BASE + j] * vector.joints[j] for j in range(JOINTS))
    trunk = add_up(constraints.trunk_J[i] * vector.base[i] for i in range(BASE))
    return Values(legs, trunk, constraints.limit_J * vector.joints)


def mul_JT(constraints: Constraints, values: Values) -> DofVector:
    """Jᵀ times a value per row."""
    legs = add_up(constraints.leg_J[:, p] * values.legs[p] for p in range(values.legs.shape[0]))  # (9, 4, N)
    trunk = add_up(constraints.trunk_J[:, t] * values.trunk[t] for t in range(values.trunk.shape[0]))
    base = trunk + add_up(legs[:BASE, leg] for leg in range(LEGS))
    return DofVector(base, legs[BASE:] + constraints.limit_J * values.limits)


def _edges(constraints: Constraints, legs: jax.Array) -> list[jax.Array]:
    """From values (P, 4, N) in directions: of the four edges of the pyramids, each (S, 4, N), and the rest's.

    An edge of the pyramid is its normal ± mu times one of its two tangents.
    """
    slots = constraints.slots
    normal, rest = legs[:slots], legs[3 * slots :]
    first, second = (constraints.friction * legs[i * slots : (i + 1) * slots] for i in (1, 2))
    return [normal + first, normal - first, normal + second, normal - second, rest]


def _edge_D(constraints: Constraints) -> list[jax.Array]:
    """D of what :func:`_edges` returns."""
    slots = constraints.slots
    return [constraints.leg_D[:slots]] * 4 + [constraints.leg_D[slots:]]


def constraint_update(constraints: Constraints, jar: Values) -> ConstraintUpdate:
    """The forces −D min(0, jar) of all rows where J qacc − aref is `jar`, and their derivatives."""
    edges, mu = _edges(constraints, jar.legs), constraints.friction
    D = _edge_D(constraints)
    active = [jp.where(edge < 0.0, d, 0.0) for edge, d in zip(edges, D, strict=True)]
    trunk = jp.where(jar.trunk < 0.0, constraints.trunk_D, 0.0)
    limits = jp.where(jar.limits < 0.0, constraints.limit_D, 0.0)
    up, down, left, right, rest = (d * edge for edge, d in zip(edges, active, strict=True))
    in_directions = [up + down + left + right, mu * (up - down), mu * (left - right), rest]
    force = Values(jp.concatenate(in_directions), trunk * jar.trunk, limits * jar.limits)
    return ConstraintUpdate(force, active, trunk, limits)


def _D_times_J(constraints: Constraints, update: ConstraintUpdate) -> jax.Array:
    """(9, P, 4, N) derivative of the legs' forces times J. The two tangents of a pyramid do not mix."""
    slots, mu = constraints.slots, constraints.friction
    normal, first, second = (constraints.leg_J[:, i * slots : (i + 1) * slots] for i in range(3))
    up, down, left, right, rest = update.legs
    by_first, by_second = mu * (up - down), mu * (left - right)
    rows = [
        (up + down + left + right) * normal + by_first * first + by_second * second,
        by_first * normal + mu * mu * (up + down) * first,
        by_second * normal + mu * mu * (left + right) * second,
        rest * constraints.leg_J[:, 3 * slots :],
    ]
    return jp.concatenate(rows, axis=1)


def hessian(barrier: FusionBarrier, qM: BlockMatrix, constraints: Constraints, update: ConstraintUpdate) -> BlockMatrix:
    """The Hessian of the solver's cost, M + Jᵀ D J over the active rows."""
    weighted_J = barrier(_D_times_J, constraints, update)
    weighted_trunk = constraints.trunk_J * update.trunk
    trunk = add_up(constraints.trunk_J[:, None, t] * weighted_trunk[None, :, t] for t in range(weighted_trunk.shape[1]))

    # Row by row in a loop, so that the result is there before the elimination takes it apart.
    def row(_: None, jacobian: jax.Array) -> tuple[None, jax.Array]:
        return None, add_up(jacobian[p] * weighted_J[:, p] for p in range(weighted_J.shape[1]))

    legs = jax.lax.scan(row, None, constraints.leg_J)[1]  # (9, 9, 4, N)
    limits = np.eye(JOINTS, dtype=np.float32)[:, :, None, None] * update.limits
    return BlockMatrix(
        qM.base + trunk + add_up(legs[:BASE, :BASE, leg] for leg in range(LEGS)),
        qM.coupling + legs[BASE:, :BASE],
        qM.joints + legs[BASE:, BASE:] + limits,
    )


def flat(constraints: Constraints, values: Values) -> jax.Array:
    """Values of all edges and rows in one (rows, N) array."""
    parts = [*_edges(constraints, values.legs), values.limits, values.trunk]
    return jp.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])


def flat_D(constraints: Constraints) -> jax.Array:
    """D in the order of :func:`flat`."""
    parts = [*_edge_D(constraints), constraints.limit_D, constraints.trunk_D]
    return jp.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])
