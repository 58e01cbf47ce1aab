"""MuJoCo's constraint problem for the A1, solved by Newton's method on the robot's own sparsity.

The accelerations a minimise ½ (a − a₀)ᵀ M (a − a₀) + Σ ½ D min(0, J a − r)², MuJoCo's primal problem with a pyramidal
cone (its documentation, "Computation"), whose rows are in rows.py.

It replaces mjx's solver, which calls LAPACK: slower for matrices this small, and in jaxlib 0.10 two CPU devices that
call it at the same time can wait for each other for ever.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics import arrow
from loco_mjx.physics.arrow import Arrow, Motion
from loco_mjx.physics.rows import Constraints, Push, Values, flat, flat_weights, hessian, product, push, transposed
from loco_mjx.physics.stage import Stage, total

PARTS = 8  # of the environments that have not converged, one in so many is solved further at a time
TOLERANCE = 0.02  # N, what may be amiss: small, as errors of many physics steps add up


def line_search(
    rows: tuple[jax.Array, jax.Array, jax.Array], linear: jax.Array, quadratic: jax.Array, iterations: int
) -> jax.Array:
    """How far to go along a direction: Newton's method on the derivative of the cost, kept within its bracket.

    Args:
        rows: of the constraints, J a − r at the start, its change per unit step, and D, each (rows, N).
        linear: (N,) derivative of the inertial cost at the start.
        quadratic: (N,) its second derivative.
        iterations: steps of Newton's method after the first, full one.

    Returns:
        (N,) step.
    """
    value, change, weight = rows
    pull, square = weight * change * value, weight * change * change

    def iterate(_: int, bracket: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        low, high, step = bracket
        active = value + step * change < 0.0
        first = linear + step * quadratic + total(jp.where(active, pull + step * square, 0.0))
        second = quadratic + total(jp.where(active, square, 0.0))
        low, high = jp.where(first < 0.0, step, low), jp.where(first > 0.0, step, high)
        moved = step - first / jp.maximum(second, 1e-30)
        outside = (moved <= low) | (moved >= high)
        middle = jp.where(jp.isinf(high), 2.0 * low, 0.5 * (low + high))
        return low, high, jp.where(first == 0.0, step, jp.where(outside, middle, moved))

    zero = 0.0 * linear
    return jax.lax.fori_loop(0, iterations, iterate, (zero, zero + jp.inf, zero + 1.0))[2]


class Problem(NamedTuple):
    """What is solved: the mass matrix, all generalised forces but the constraints', and the constraints."""

    inertia: Arrow
    force: Motion
    constraints: Constraints


def _newton(stage: Stage, problem: Problem, point: Motion, ls_iterations: int) -> tuple[Motion, jax.Array]:
    """One iteration of Newton's method: the next point, and what is amiss there (N,), N.

    The method goes where the cost would be least if every row pushed, or did not, all the way as it does at the start.
    Then only the rows that have changed sides push otherwise than was reckoned with. Their forces are what is amiss.
    """
    inertia, force, constraints = problem
    reference = Values(constraints.leg_reference, constraints.trunk_reference, constraints.limit_reference)

    def look(point: Motion) -> tuple[Values, Motion, Push]:
        residual = jax.tree.map(jp.subtract, product(constraints, point), reference)
        momentum = jax.tree.map(jp.subtract, arrow.multiply(inertia, point), force)
        return residual, momentum, push(constraints, residual)

    def along(search: Motion) -> tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
        linear, quadratic = arrow.inner(search, momentum), arrow.inner(search, arrow.multiply(inertia, search))
        slope = product(constraints, search)
        return linear, quadratic, (flat(constraints, residual), flat(constraints, slope), flat_weights(constraints))

    residual, momentum, pushed = stage(look, point)
    gradient = stage(lambda: jax.tree.map(jp.add, momentum, transposed(constraints, pushed.force)))
    curvature = hessian(stage, inertia, constraints, pushed)
    search = jax.tree.map(jp.negative, arrow.solve(curvature, gradient))
    linear, quadratic, rows = stage(along, search)
    step = line_search(rows, linear, quadratic, ls_iterations)
    value, change, weight = rows
    after = value + step * change
    changed = total(jp.where((value < 0.0) != (after < 0.0), weight * jp.abs(after), 0.0))
    left = jp.abs(1.0 - step) * (total(jp.abs(gradient.base)) + total(total(jp.abs(gradient.joints))))
    amiss = changed + left
    return jax.tree.map(lambda a, b: a + step * b, point, search), amiss


def _repeat(
    stage: Stage, problem: Problem, start: Motion, iterations: int, ls_iterations: int
) -> tuple[Motion, jax.Array]:
    """Some iterations: the point, and what is amiss there (N,)."""
    if iterations == 1:
        return _newton(stage, problem, start, ls_iterations)
    again = lambda _, at: _newton(stage, problem, at[0], ls_iterations)  # noqa: E731
    return jax.lax.fori_loop(0, iterations, again, (start, 0.0 * problem.constraints.friction))


def _finish(
    stage: Stage, problem: Problem, point: Motion, amiss: jax.Array, iterations: int, ls_iterations: int
) -> Motion:
    """More iterations for those environments where something is amiss, an eighth of all at a time.

    Few of them need it at the same time, chiefly those whose feet begin to slide, so it costs little. Whether one gets
    it is its own affair: no environment's result depends on its neighbours.
    """
    part = max(1, amiss.shape[0] // PARTS)

    def some(carry: tuple[Motion, jax.Array]) -> tuple[Motion, jax.Array]:
        point, amiss = carry
        worst, index = jax.lax.top_k(amiss, part)
        picked, start = jax.tree.map(lambda x: x[..., index], (problem, point))
        better = _repeat(stage, picked, start, iterations, ls_iterations)[0]
        new = jax.tree.map(lambda a, b: jp.where(worst > 0.0, a, b), better, start)
        point = jax.tree.map(lambda x, y: x.at[..., index].set(y), point, new)
        return point, amiss.at[index].set(0.0)

    amiss = jp.where(amiss > TOLERANCE, amiss, 0.0)  # nothing helps one that is not finite
    return jax.lax.while_loop(lambda carry: jp.any(carry[1] > 0.0), some, (point, amiss))[0]


def solve(
    stage: Stage, problem: Problem, start: Motion, iterations: int, ls_iterations: int, more_iterations: int = 0
) -> Motion:
    """Accelerations under the constraints.

    Args:
        stage: how to compute intermediate results once.
        problem: what is solved.
        start: where to start, such as the last step's accelerations.
        iterations: Newton iterations of all environments.
        ls_iterations: iterations of each line search.
        more_iterations: further Newton iterations of those environments that have not converged.
    """
    point, amiss = _repeat(stage, problem, start, iterations, ls_iterations)
    if not more_iterations:
        return point
    return _finish(stage, problem, point, amiss, more_iterations, ls_iterations)
