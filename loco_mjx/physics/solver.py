"""MuJoCo's constraint problem for the A1, solved by Newton's method on the robot's own sparsity.

The accelerations a minimise ½ (a − a₀)ᵀ M (a − a₀) + Σ ½ D min(0, J a − a_ref)², MuJoCo's primal problem with a pyramidal
cone (its documentation, "Computation"). Every contact moves the base and one leg only, so the Hessian M + Jᵀ D J has
the shape of an arrow: a 6 × 6 block for the base, four 3 × 3 blocks for the legs, and what couples each to the base.
Eliminating the legs first takes about 1,000 multiplications, a tenth of a dense factorisation, in plain arithmetic that
vectorises over environments. (mjx's solver calls LAPACK, which is slower for matrices this small, and in jaxlib 0.10
two CPU devices that call it at the same time can wait for each other for ever.)

Arrays have their components first, then the four legs where there are legs, and the N environments last, which is how
XLA makes vector code of it on a CPU. `keep` stops it from fusing a value into each of its uses and computing it anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jp
import numpy as np

BASE, JOINTS, LEGS = 6, 3, 4  # degrees of freedom of the base, and of a leg; legs
OWN = BASE + JOINTS  # what moves a point on a leg: the base's degrees of freedom, then the leg's joints
T = TypeVar("T")


class Motion(NamedTuple):
    """A vector over the degrees of freedom: base (6, N), joints (3, 4, N), hip, thigh, calf."""

    base: jax.Array
    joints: jax.Array


class Inertia(NamedTuple):
    """The mass matrix, which has no entries between legs.

    Attributes:
        base: (6, 6, N).
        coupling: (3, 6, 4, N), a row for each joint.
        joints: (3, 3, 4, N).
    """

    base: jax.Array
    coupling: jax.Array
    joints: jax.Array


class Constraints(NamedTuple):
    """Everything that pushes. Rows with weight 0 are out of contact.

    The P rows of a leg are, for its foot's F slots, F normals, F first tangents, F second tangents, then those of
    contacts without friction: P = 3 F + 2.

    Attributes:
        legs: (9, P, 4, N) Jacobian of the legs' contacts: in the base's degrees of freedom, then in the leg's joints.
        leg_reference: (P, 4, N) reference acceleration in each direction.
        leg_weight: (F + 2, 4, N) D, of every edge of a foot's friction pyramid, and of what has no friction.
        friction: (N,) coefficient of the feet.
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
        """F, contact slots with friction per leg."""
        return self.leg_weight.shape[0] - 2


class Values(NamedTuple):
    """A number for each row of the constraints: legs (P, 4, N), trunk (T, N), limits (3, 4, N)."""

    legs: jax.Array
    trunk: jax.Array
    limits: jax.Array


class Stage:
    """Makes XLA finish what a function computes before anything else uses it.

    On CPUs XLA fuses cheap arithmetic into every one of its uses and computes it again for each, which for this much
    arithmetic costs more than anything else, and its own optimization barrier is gone by the time it fuses. A branch
    is never taken apart. On GPUs, where branches wait for the host and XLA fuses better, functions are simply called.
    """

    def __init__(self, always: jax.Array) -> None:
        """`always` is true, in a way that XLA cannot know while it compiles."""
        self._always = always

    def __call__(self, function: Callable[..., T], *args: Any) -> T:
        """function(*args), finished."""
        if jax.default_backend() != "cpu":
            return function(*args)
        shapes = jax.eval_shape(function, *args)
        nothing = lambda *_: jax.tree.map(lambda x: jp.zeros(x.shape, x.dtype), shapes)  # noqa: E731
        return jax.lax.cond(self._always, function, nothing, *args)


def total(array: jax.Array) -> jax.Array:
    """Sum over the first axis, written out: XLA's own reduction would not vectorise over the last."""
    return sum(array[i] for i in range(array.shape[0]))  # type: ignore[return-value]


def stack(arrays: list[jax.Array], axis: int = 0) -> jax.Array:
    return jp.stack(arrays, axis)


def concatenate(arrays: list[jax.Array], axis: int = 0) -> jax.Array:
    return jp.concatenate(arrays, axis)


def split(vector: jax.Array) -> Motion:
    """The parts of an (18, N) array."""
    joints = vector[BASE:].reshape(LEGS, JOINTS, -1)
    return Motion(vector[:BASE], jp.swapaxes(joints, 0, 1))


def join(vector: Motion) -> jax.Array:
    """The (18, N) array of its parts."""
    joints = jp.swapaxes(vector.joints, 0, 1)
    return jp.concatenate([vector.base, joints.reshape(LEGS * JOINTS, -1)])


def inertia_parts(matrix: jax.Array) -> Inertia:
    """The parts of an (18, 18, N) mass matrix."""
    rows = jp.moveaxis(matrix[BASE:].reshape(LEGS, JOINTS, BASE + LEGS * JOINTS, -1), 0, 2)
    first = lambda leg: BASE + JOINTS * leg  # noqa: E731
    joints = [rows[:, first(leg) : first(leg) + JOINTS, leg] for leg in range(LEGS)]
    return (Inertia(matrix[:BASE, :BASE], rows[:, :BASE], jp.stack(joints, axis=2)))


def _inner(a: Motion, b: Motion) -> jax.Array:
    """Dot product (N,)."""
    return total(a.base * b.base) + total(total(a.joints * b.joints))


def multiply(matrix: Inertia, vector: Motion) -> Motion:
    """Mass matrix times vector."""
    onto_base = total(matrix.coupling * vector.joints[:, None])  # (6, 4, N)
    base = sum(matrix.base[:, c] * vector.base[c] for c in range(BASE)) + sum(onto_base[:, leg] for leg in range(LEGS))
    joints = sum(matrix.coupling[:, c] * vector.base[c] for c in range(BASE))
    joints = joints + sum(matrix.joints[:, j] * vector.joints[j] for j in range(JOINTS))
    return Motion(base, joints)  # type: ignore[arg-type]


def gauss_jordan(matrix: jax.Array) -> jax.Array:
    """Solves positive definite systems by elimination, which for such matrices needs no pivoting.

    Args:
        matrix: (n, n + k, ...) the matrices, and k right-hand sides beside them.

    Returns:
        (n, k, ...) the solutions.
    """
    n = matrix.shape[0]
    index = np.arange(n, dtype=np.int32).reshape(-1, *[1] * (matrix.ndim - 1))

    # A loop, because unrolled XLA would fuse the steps and compute every element again for each of its uses.
    def step(k: jax.Array, matrix: jax.Array) -> jax.Array:
        pivot_row = jax.lax.dynamic_index_in_dim(matrix, k, 0, keepdims=True)
        row = pivot_row / jax.lax.dynamic_index_in_dim(pivot_row, k, 1, keepdims=True)
        column = jax.lax.dynamic_index_in_dim(matrix, k, 1, keepdims=True)
        return jp.where(index == k, row, matrix - column * row)

    return jax.lax.fori_loop(0, n, step, matrix)[:, n:]


def _product(constraints: Constraints, vector: Motion) -> Values:
    """Jacobian times vector."""
    legs = sum(constraints.legs[i] * vector.base[i] for i in range(BASE))
    legs = legs + sum(constraints.legs[BASE + j] * vector.joints[j] for j in range(JOINTS))
    trunk = sum(constraints.trunk[i] * vector.base[i] for i in range(BASE))
    return Values(legs, trunk, constraints.limit_sign * vector.joints)  # type: ignore[arg-type]


def _edges(constraints: Constraints, legs: jax.Array) -> list[jax.Array]:
    """Values (P, 4, N) in directions, as values of the four edges of the feet's pyramids, each (F, 4, N), and the rest."""
    slots = constraints.slots
    normal, rest = legs[:slots], legs[3 * slots :]
    first, second = (constraints.friction * legs[i * slots : (i + 1) * slots] for i in (1, 2))
    return [normal + first, normal - first, normal + second, normal - second, rest]


class _Push(NamedTuple):
    """Of the constraints at a point: minus their forces, per row, and what their derivatives are made of.

    Attributes:
        force: per row, legs' in each direction.
        legs: weights of the active edges, as in :func:`_edges`.
        trunk: (T, N) weights of the active rows.
        limits: (3, 4, N).
    """

    force: Values
    legs: list[jax.Array]
    trunk: jax.Array
    limits: jax.Array


def _push(constraints: Constraints, residual: Values) -> _Push:
    slots, mu = constraints.slots, constraints.friction
    edges = _edges(constraints, residual.legs)
    weights = [constraints.leg_weight[:slots]] * 4 + [constraints.leg_weight[slots:]]
    active = ([jp.where(edge < 0.0, weight, 0.0) for edge, weight in zip(edges, weights, strict=True)])
    trunk = jp.where(residual.trunk < 0.0, constraints.trunk_weight, 0.0)
    limits = jp.where(residual.limits < 0.0, constraints.limit_weight, 0.0)
    force = [weight * edge for edge, weight in zip(edges, active, strict=True)]
    in_directions = concatenate(
        [force[0] + force[1] + force[2] + force[3], mu * (force[0] - force[1]), mu * (force[2] - force[3]), force[4]]
    )
    return (_Push(Values(in_directions, trunk * residual.trunk, limits * residual.limits), active, trunk, limits))


def _transposed(constraints: Constraints, values: Values) -> Motion:
    """Transposed Jacobian times a value per row."""
    legs = sum(constraints.legs[:, p] * values.legs[p] for p in range(values.legs.shape[0]))  # (9, 4, N)
    trunk = sum(constraints.trunk[:, t] * values.trunk[t] for t in range(values.trunk.shape[0]))
    base = trunk + sum(legs[:BASE, leg] for leg in range(LEGS))  # type: ignore[index]
    return Motion(base, legs[BASE:] + constraints.limit_sign * values.limits)  # type: ignore[index]


def _leg_stiffness(constraints: Constraints, push: _Push) -> jax.Array:
    """(9, 9, 4, N) Jᵀ · (derivative of the forces) · J of the legs' contacts."""
    slots, mu = constraints.slots, constraints.friction
    normal, first, second = (constraints.legs[:, i * slots : (i + 1) * slots] for i in range(3))
    rest = constraints.legs[:, 3 * slots :]
    up, down, left, right, free = push.legs
    # The pyramid's stiffness in (normal, first, second): the two tangents do not mix.
    by_first, by_second = mu * (up - down), mu * (left - right)
    stiff = concatenate(
        [
            (up + down + left + right) * normal + by_first * first + by_second * second,
            by_first * normal + mu * mu * (up + down) * first,
            by_second * normal + mu * mu * (left + right) * second,
            free * rest,
        ],
        axis=1,
    )

    # Row by row in a loop, so that the result is there before the elimination takes it apart.
    def row(_: None, jacobian: jax.Array) -> tuple[None, jax.Array]:
        return None, sum(jacobian[p] * stiff[:, p] for p in range(stiff.shape[1]))  # type: ignore[return-value]

    return jax.lax.scan(row, None, constraints.legs)[1]


def _newton_direction(inertia: Inertia, constraints: Constraints, push: _Push, gradient: Motion) -> Motion:
    """The Hessian's inverse times the gradient: the legs are eliminated, then the base is solved."""
    stiffness = _leg_stiffness(constraints, push)
    limits = np.eye(JOINTS, dtype=np.float32)[:, :, None, None] * push.limits
    coupling = (inertia.coupling + stiffness[BASE:, :BASE])  # (3, 6, 4, N)
    joints = inertia.joints + stiffness[BASE:, BASE:] + limits
    solved = gauss_jordan(concatenate([joints, coupling, gradient.joints[:, None]], axis=1))  # (3, 7, 4, N)
    gain = (sum(coupling[j][:, None] * solved[j][None] for j in range(JOINTS)))  # (6, 7, 4, N)
    weighted = constraints.trunk * push.trunk
    trunk = sum(constraints.trunk[:, None, t] * weighted[None, :, t] for t in range(weighted.shape[1]))
    base = inertia.base + trunk + sum(stiffness[:BASE, :BASE, leg] - gain[:, :BASE, leg] for leg in range(LEGS))
    right = gradient.base - sum(gain[:, BASE, leg] for leg in range(LEGS))
    x = gauss_jordan(concatenate([base, right[:, None]], axis=1))[:, 0]
    return (Motion(x, solved[:, BASE] - sum(solved[:, c] * x[c] for c in range(BASE))))


def _line_search(
    constraints: Constraints, residual: Values, slope: Values, linear: jax.Array, quadratic: jax.Array, iterations: int
) -> jax.Array:
    """How far to go along a direction: Newton's method on the derivative of the cost, kept within its bracket.

    Args:
        constraints: their weights.
        residual: J a − a_ref at the start.
        slope: its change per unit step.
        linear: (N,) derivative of the inertial cost at the start.
        quadratic: (N,) its second derivative.
        iterations: steps of Newton's method after the first, full one.

    Returns:
        (N,) step.
    """
    slots = constraints.slots
    weights = [constraints.leg_weight[:slots]] * 4 + [constraints.leg_weight[slots:]]
    legs = zip(_edges(constraints, residual.legs), _edges(constraints, slope.legs), weights, strict=True)
    limits = (residual.limits, slope.limits, constraints.limit_weight)
    grouped = [*legs, limits, (residual.trunk, slope.trunk, constraints.trunk_weight)]
    flat = lambda i: concatenate([g[i].reshape(-1, g[i].shape[-1]) for g in grouped])  # noqa: E731
    value, change, weight = flat(0), flat(1), flat(2)
    pull, square = ((weight * change * value, weight * change * change))

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

    bracket = (jp.zeros_like(linear), jp.full_like(linear, jp.inf), jp.ones_like(linear))
    return jax.lax.fori_loop(0, iterations, iterate, bracket)[2]


def _newton(
    stage: Stage, inertia: Inertia, force: Motion, constraints: Constraints, point: Motion, ls_iterations: int
) -> Motion:
    """One iteration of Newton's method."""
    reference = Values(constraints.leg_reference, constraints.trunk_reference, constraints.limit_reference)

    def look(point: Motion) -> tuple[Values, Motion, _Push]:
        residual = jax.tree.map(jp.subtract, _product(constraints, point), reference)
        momentum = jax.tree.map(jp.subtract, multiply(inertia, point), force)
        return residual, momentum, _push(constraints, residual)

    def along(search: Motion) -> tuple[jax.Array, jax.Array, Values]:
        return _inner(search, momentum), _inner(search, multiply(inertia, search)), _product(constraints, search)

    residual, momentum, push = stage(look, point)
    gradient = stage(lambda: jax.tree.map(jp.add, momentum, _transposed(constraints, push.force)))
    search = jax.tree.map(jp.negative, _newton_direction(inertia, constraints, push, gradient))
    linear, quadratic, slope = stage(along, search)
    step = _line_search(constraints, residual, slope, linear, quadratic, ls_iterations)
    return jax.tree.map(lambda a, b: a + step * b, point, search)


def solve(
    stage: Stage, inertia: Inertia, force: Motion, constraints: Constraints, start: Motion, iterations: int, ls_iterations: int
) -> Motion:
    """Accelerations under the constraints.

    Args:
        inertia: the mass matrix.
        force: all generalised forces but the constraints'.
        constraints: contacts and joint limits.
        start: where to start, such as the last step's accelerations.
        iterations: Newton iterations.
        ls_iterations: iterations of each line search.
    """
    if iterations == 1:
        return _newton(stage, inertia, force, constraints, start, ls_iterations)
    step = lambda _, point: _newton(stage, inertia, force, constraints, point, ls_iterations)  # noqa: E731
    return jax.lax.fori_loop(0, iterations, step, start)
