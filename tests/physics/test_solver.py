"""The solver against dense linear algebra in float64."""

from __future__ import annotations

import itertools
from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.physics import block_matrix, solver
from loco_mjx.physics.efc import Constraints
from loco_mjx.physics.xla import FusionBarrier

N, SLOTS, REST, TRUNK = 3, 4, 2, 6


def _dense_like_the_robot(rng: np.random.Generator) -> np.ndarray:
    """(18, 18, N) positive definite matrices without entries between legs."""
    out = np.zeros((18, 18, N))
    for n in range(N):
        for leg in range(4):
            own = [*range(6), *range(6 + 3 * leg, 9 + 3 * leg)]
            root = rng.normal(size=(9, 9))
            out[np.ix_(own, own, [n])] += (root @ root.T + np.eye(9))[..., None]
    return out


def _constraints(rng: np.random.Generator) -> Constraints:
    rows = 3 * SLOTS + REST
    draw = lambda *shape: jp.asarray(rng.normal(size=(*shape, N)), jp.float32)  # noqa: E731
    weight = lambda *shape: jp.asarray(rng.uniform(size=(*shape, N)) * rng.integers(0, 2, (*shape, N)), jp.float32)  # noqa: E731
    return Constraints(
        leg_J=draw(9, rows, 4),
        leg_aref=draw(rows, 4),
        leg_D=weight(SLOTS + REST, 4),
        friction=jp.asarray(rng.uniform(0.4, 1.2, N), jp.float32),
        trunk_J=draw(6, TRUNK),
        trunk_aref=draw(TRUNK),
        trunk_D=weight(TRUNK),
        limit_J=jp.sign(draw(3, 4)),
        limit_aref=draw(3, 4),
        limit_D=weight(3, 4),
    )


def _dense_rows(constraints: Constraints, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian (rows, 18), reference and D of environment n, every pyramid edge a row, written out."""
    c = jax.tree.map(lambda x: np.asarray(x, np.float64)[..., n], constraints)
    jacobian, reference, weight = [], [], []
    for leg in range(4):
        wide = np.zeros((c.leg_J.shape[1], 18))
        wide[:, :6], wide[:, 6 + 3 * leg : 9 + 3 * leg] = c.leg_J[:6, :, leg].T, c.leg_J[6:, :, leg].T
        for slot in range(SLOTS):
            for tangent in (1, 2):
                for sign in (1, -1):
                    other = tangent * SLOTS + slot
                    jacobian.append(wide[slot] + sign * c.friction * wide[other])
                    reference.append(c.leg_aref[slot, leg] + sign * c.friction * c.leg_aref[other, leg])
                    weight.append(c.leg_D[slot, leg])
        for rest in range(REST):
            jacobian.append(wide[3 * SLOTS + rest])
            reference.append(c.leg_aref[3 * SLOTS + rest, leg])
            weight.append(c.leg_D[SLOTS + rest, leg])
        for joint in range(3):
            jacobian.append(c.limit_J[joint, leg] * np.eye(18)[6 + 3 * leg + joint])
            reference.append(c.limit_aref[joint, leg])
            weight.append(c.limit_D[joint, leg])
    for t in range(TRUNK):
        jacobian.append(np.concatenate([c.trunk_J[:, t], np.zeros(12)]))
        reference.append(c.trunk_aref[t])
        weight.append(c.trunk_D[t])
    return np.array(jacobian), np.array(reference), np.array(weight)


def _cost_and_gradient(
    inertia: np.ndarray, force: np.ndarray, rows: tuple[np.ndarray, ...], a: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, its gradient and its Hessian."""
    jacobian, reference, weight = rows
    residual = jacobian @ a - reference
    active = weight * (residual < 0)
    cost = 0.5 * a @ inertia @ a - force @ a + 0.5 * active @ residual**2
    gradient = inertia @ a - force + jacobian.T @ (active * residual)
    return cost, gradient, inertia + jacobian.T @ (active[:, None] * jacobian)


@pytest.fixture
def problem():
    rng = np.random.default_rng(5)
    dense = _dense_like_the_robot(rng)
    force, start = rng.normal(size=(18, N)) * 5.0, rng.normal(size=(18, N))
    return dense, force, start, _constraints(rng)


def _solve(problem, iterations: int, ls_iterations: int, more: int = 0) -> np.ndarray:
    dense, force, start, constraints = problem
    single = lambda x: jp.asarray(x, jp.float32)  # noqa: E731
    out = _solved(single(dense), single(force), single(start), constraints, iterations, ls_iterations, more)
    return np.asarray(out, np.float64)


@partial(jax.jit, static_argnums=(4, 5, 6))
def _solved(dense, force, start, constraints, *iterations: int) -> jax.Array:
    problem = solver.Problem(block_matrix.from_dense(dense), block_matrix.split(force), constraints)
    return block_matrix.join(solver.solve(FusionBarrier(), problem, block_matrix.split(start), *iterations))


def test_split_and_join_are_inverse():
    vector = jp.arange(18.0 * N).reshape(18, N)
    parts = block_matrix.split(vector)
    np.testing.assert_array_equal(block_matrix.join(parts), vector)
    np.testing.assert_array_equal(parts.joints[1, 2], vector[6 + 3 * 2 + 1])  # thigh of the third leg


def test_block_algebra_is_dense_algebra(problem):
    dense, force, _, _ = problem
    matrix = block_matrix.from_dense(jp.asarray(dense, jp.float32))
    vector = block_matrix.split(jp.asarray(force, jp.float32))
    product = block_matrix.join(block_matrix.multiply(matrix, vector))
    np.testing.assert_allclose(product, np.einsum("ijn,jn->in", dense, force), rtol=1e-4, atol=1e-3)
    solution = block_matrix.join(block_matrix.solve(matrix, vector))
    expected = np.stack([np.linalg.solve(dense[:, :, n], force[:, n]) for n in range(N)], axis=1)
    np.testing.assert_allclose(solution, expected, rtol=2e-3, atol=1e-4)
    np.testing.assert_allclose(block_matrix.inner(vector, vector), (force**2).sum(axis=0), rtol=1e-5)


def test_gauss_jordan():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(N, 5, 5))
    matrix, right = root @ root.transpose(0, 2, 1) + np.eye(5), rng.normal(size=(N, 5, 2))
    both = np.moveaxis(np.concatenate([matrix, right], axis=2), 0, -1).astype(np.float32)
    solved = np.moveaxis(np.asarray(block_matrix.gauss_jordan(jp.asarray(both))), -1, 0)
    np.testing.assert_allclose(solved, np.linalg.solve(matrix, right), rtol=1e-3, atol=1e-4)


def test_one_iteration_is_one_newton_step_with_its_best_length(problem):
    dense, force, start, constraints = problem
    ours = _solve(problem, 1, 40)
    for n in range(N):
        rows = _dense_rows(constraints, n)
        _, gradient, hessian = _cost_and_gradient(dense[:, :, n], force[:, n], rows, start[:, n])
        direction = -np.linalg.solve(hessian, gradient)
        lengths = np.linspace(0.0, 3.0, 30001)
        points = start[:, n] + lengths[:, None] * direction
        residual = points @ rows[0].T - rows[1]
        rest = 0.5 * np.einsum("ti,ij,tj->t", points, dense[:, :, n], points, optimize=True) - points @ force[:, n]
        best = points[np.argmin(rest + 0.5 * np.minimum(residual, 0.0) ** 2 @ rows[2])]
        np.testing.assert_allclose(ours[:, n], best, atol=3e-3)


def test_converged_solution_has_no_gradient(problem):
    dense, force, start, constraints = problem
    ours = _solve(problem, 20, 20)
    for n in range(N):
        rows = _dense_rows(constraints, n)
        at_start = _cost_and_gradient(dense[:, :, n], force[:, n], rows, start[:, n])
        at_end = _cost_and_gradient(dense[:, :, n], force[:, n], rows, ours[:, n])
        assert at_end[0] < at_start[0]
        assert np.abs(at_end[1]).max() < 1e-4 * np.abs(at_start[1]).max()


def test_who_needs_more_iterations_gets_them_and_no_other_notices(problem):
    _, force, start, _ = problem
    converged = _solve(problem, 40, 20)
    start[:, 1] = converged[:, 1]  # one of them is there already
    np.testing.assert_allclose(_solve(problem, 1, 20, 40), converged, atol=2e-3)
    one = _solve(problem, 1, 20)
    assert np.abs(one - converged).max() > 0.1  # the others are not, after one
    force[:, 0] = np.nan
    broken = _solve(problem, 1, 20, 40)
    assert np.isnan(broken[:, 0]).all()
    np.testing.assert_allclose(broken[:, 1:], converged[:, 1:], atol=2e-3)


def test_every_iteration_lowers_the_cost(problem):
    dense, force, start, constraints = problem
    points = [start, *[_solve(problem, iterations, 6) for iterations in (1, 2, 3)]]
    for n in range(N):
        rows = _dense_rows(constraints, n)
        costs = [_cost_and_gradient(dense[:, :, n], force[:, n], rows, point[:, n])[0] for point in points]
        assert all(later <= earlier + 1e-4 for earlier, later in itertools.pairwise(costs))
        assert costs[1] < costs[0]


def test_line_search_by_hand():
    # φ(t) = ½ (t − 2)² + ½ · 3 · min(0, 4 − 2 t)²: the row bites beyond t = 2, where the minimum is.
    one = lambda x: jp.array([x], jp.float32)  # noqa: E731
    row = tuple(jp.array([[x]], jp.float32) for x in (4.0, -2.0, 3.0))
    np.testing.assert_allclose(solver.line_search(row, one(-2.0), one(1.0), 10), 2.0, atol=1e-5)
    # φ(t) = −2 t + ½ t² + ½ · 3 · min(0, −1 + t)²: φ′ = −2 + t + 3 (t − 1) below t = 1, so the minimum is t = 2 beyond.
    row = tuple(jp.array([[x]], jp.float32) for x in (-1.0, 1.0, 3.0))
    np.testing.assert_allclose(solver.line_search(row, one(-2.0), one(1.0), 10), 2.0, atol=1e-5)
