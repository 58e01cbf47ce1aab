"""MuJoCo's constraint problem for a quadruped, solved by Newton's method on the robot's own sparsity.

The accelerations a minimise ½ (a − a₀)ᵀ M (a − a₀) + Σ ½ D min(0, J a − r)², MuJoCo's primal problem with a pyramidal
cone (its documentation, "Computation"), whose rows are in efc.py.

MJX's own solver calls LAPACK: slower for matrices this small, and in jaxlib 0.10 two CPU devices that
call it at the same time can wait for each other for ever.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics import block_matrix
from loco_mjx.physics.block_matrix import BlockMatrix, DofVector
from loco_mjx.physics.efc import (
    Constraints,
    ConstraintUpdate,
    Values,
    constraint_update,
    flat,
    flat_D,
    hessian,
    mul_J,
    mul_JT,
)
from loco_mjx.physics.xla import FusionBarrier, column_sums, total

PARTS = 8  # of the environments that have not converged, one in so many is solved further at a time
TOLERANCE = 0.02  # N and N·m, forces that may be wrong


def line_search(
    rows: tuple[jax.Array, jax.Array, jax.Array], linear: jax.Array, quadratic: jax.Array, iterations: int
) -> jax.Array:
    """How far to go along a direction: Newton's method on the derivative of the cost, kept within its bracket.

    Args:
        rows: of the constraints, jar at the start, jv and D, each (rows, N).
        linear: (N,) derivative of the Gauss cost ½ (qacc − qacc_smooth)ᵀ M (qacc − qacc_smooth) at the start.
        quadratic: (N,) its second derivative.
        iterations: steps of Newton's method after the first, full one.

    Returns:
        (N,) alpha.
    """
    jar, jv, D = rows
    first_of_row, second_of_row = D * jv * jar, D * jv * jv

    def iterate(_: int, bracket: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        low, high, alpha = bracket
        active = jar + alpha * jv < 0.0
        of_rows = [first_of_row + alpha * second_of_row, second_of_row]
        sums = column_sums(jp.concatenate([jp.where(active, row, 0.0) for row in of_rows], axis=-1))
        first, second = jp.split(sums, 2)
        first, second = linear + alpha * quadratic + first, quadratic + second
        low, high = jp.where(first < 0.0, alpha, low), jp.where(first > 0.0, alpha, high)
        moved = alpha - first / jp.maximum(second, 1e-30)
        outside = (moved <= low) | (moved >= high)
        middle = jp.where(jp.isinf(high), 2.0 * low, 0.5 * (low + high))
        return low, high, jp.where(first == 0.0, alpha, jp.where(outside, middle, moved))

    zero = 0.0 * linear
    return jax.lax.fori_loop(0, iterations, iterate, (zero, zero + jp.inf, zero + 1.0))[2]


class Problem(NamedTuple):
    """What is solved: the mass matrix, all generalised forces but the constraints', and the constraints."""

    qM: BlockMatrix
    qfrc_smooth: DofVector
    constraints: Constraints


def _newton(
    barrier: FusionBarrier, problem: Problem, qacc: DofVector, ls_iterations: int
) -> tuple[DofVector, jax.Array]:
    """One iteration of Newton's method: the next qacc, and the forces that are wrong there (N,), N.

    A full step goes to the minimum for the rows that are active at its start. Then only the rows that have become
    active, or no longer are, have forces that the step did not reckon with: these are what is wrong.
    """
    qM, qfrc_smooth, constraints = problem
    aref = Values(constraints.leg_aref, constraints.trunk_aref, constraints.limit_aref)

    def evaluate(qacc: DofVector) -> tuple[Values, DofVector, ConstraintUpdate]:
        jar = jax.tree.map(jp.subtract, mul_J(constraints, qacc), aref)
        gauss = jax.tree.map(jp.subtract, block_matrix.multiply(qM, qacc), qfrc_smooth)  # M qacc − qfrc_smooth
        return jar, gauss, constraint_update(constraints, jar)

    def along(search: DofVector) -> tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
        linear = block_matrix.inner(search, gauss)
        quadratic = block_matrix.inner(search, block_matrix.multiply(qM, search))
        jv = mul_J(constraints, search)
        return linear, quadratic, (flat(constraints, jar), flat(constraints, jv), flat_D(constraints))

    jar, gauss, update = barrier(evaluate, qacc)
    grad = barrier(lambda: jax.tree.map(jp.add, gauss, mul_JT(constraints, update.force)))
    search = jax.tree.map(jp.negative, block_matrix.solve(hessian(barrier, qM, constraints, update), grad))
    linear, quadratic, rows = barrier(along, search)
    alpha = line_search(rows, linear, quadratic, ls_iterations)
    before, jv_rows, D = rows
    after = before + alpha * jv_rows
    changed = column_sums(jp.where((before < 0.0) != (after < 0.0), D * jp.abs(after), 0.0))
    left = jp.abs(1.0 - alpha) * (total(jp.abs(grad.base)) + total(total(jp.abs(grad.joints))))
    return jax.tree.map(lambda a, b: a + alpha * b, qacc, search), changed + left


def _repeat(
    barrier: FusionBarrier, problem: Problem, start: DofVector, iterations: int, ls_iterations: int
) -> tuple[DofVector, jax.Array]:
    """Some iterations: qacc, and the forces that are wrong there (N,), N."""
    if iterations == 1:
        return _newton(barrier, problem, start, ls_iterations)
    again = lambda _, at: _newton(barrier, problem, at[0], ls_iterations)  # noqa: E731
    return jax.lax.fori_loop(0, iterations, again, (start, 0.0 * problem.constraints.friction))


def _finish(
    barrier: FusionBarrier, problem: Problem, qacc: DofVector, wrong: jax.Array, iterations: int, ls_iterations: int
) -> DofVector:
    """More iterations for those environments that have not converged, an eighth of all at a time.

    Few of them need it at the same time, chiefly those whose feet begin to slide, so it costs little. Whether one gets
    it is its own affair: no environment's result depends on its neighbours.
    """
    part = max(1, wrong.shape[0] // PARTS)

    def some(carry: tuple[DofVector, jax.Array]) -> tuple[DofVector, jax.Array]:
        qacc, wrong = carry
        worst, index = jax.lax.top_k(wrong, part)
        picked, start = jax.tree.map(lambda x: x[..., index], (problem, qacc))
        better = _repeat(barrier, picked, start, iterations, ls_iterations)[0]
        new = jax.tree.map(lambda a, b: jp.where(worst > 0.0, a, b), better, start)
        qacc = jax.tree.map(lambda x, y: x.at[..., index].set(y), qacc, new)
        return qacc, wrong.at[index].set(0.0)

    wrong = jp.where(wrong > TOLERANCE, wrong, 0.0)  # nothing helps one that is not finite
    return jax.lax.while_loop(lambda carry: jp.any(carry[1] > 0.0), some, (qacc, wrong))[0]


def solve(
    barrier: FusionBarrier,
    problem: Problem,
    start: DofVector,
    iterations: int,
    ls_iterations: int,
    more_iterations: int = 0,
) -> DofVector:
    """Qacc under the constraints.

    Args:
        barrier: keeps XLA from computing intermediate results again.
        problem: what is solved.
        start: qacc to start from, such as the last step's: MuJoCo's warmstart.
        iterations: Newton iterations of all environments.
        ls_iterations: iterations of each line search.
        more_iterations: further Newton iterations of those environments that have not converged.
    """
    qacc, wrong = _repeat(barrier, problem, start, iterations, ls_iterations)
    if not more_iterations:
        return qacc
    return _finish(barrier, problem, qacc, wrong, more_iterations, ls_iterations)
