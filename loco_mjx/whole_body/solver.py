"""The quadratic program of the forces solved in JAX: an interior-point method with a fixed number of iterations.

Mehrotra's predictor and corrector; its linear systems by Riccati's recursion (riccati.py). Costs are in units of the
weight on forces, so that the cost's curvature is 1 at least: where the Lagrangian's gradient is r and complementarity
is t in all, the 12 · horizon forces together are off by |r| + √(2 t) newtons at most. Of all points on the way the one
with the least bound is taken, and the program is solved if that bound is small. Rounding keeps it above 0.05 N.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.physics.batch import together
from loco_mjx.physics.xla import FusionBarrier, add_up
from loco_mjx.whole_body import pyramid, riccati
from loco_mjx.whole_body.config import Mpc
from loco_mjx.whole_body.controller import Solution, Solver
from loco_mjx.whole_body.mpc import GRAVITY, Problem

ITERATIONS = 18  # most programs take 8, those of a robot that is pushed hard or falls up to 16
STAY = 0.95  # part of the way to the nearest bound that a step may go
FLOOR = 1e-7  # N², complementarity of a row that is aimed at, at least; in float32 less is lost in rounding
START = 1e4  # N², complementarity of a row at the start
TOLERANCE = 1.0  # N, of the bound
SOLVED = 1e-9  # N², below which a gap is not divided by


class Point(NamedTuple):
    """Where the method is, robots last.

    Attributes:
        forces: (H, 4, 3, N) N.
        slack: (H, 4, 6, N) to the pyramids' bounds, positive, N.
        price: (H, 4, 6, N) of the bounds, positive, N.
    """

    forces: jax.Array
    slack: jax.Array
    price: jax.Array


class Terms(NamedTuple):
    """A batch of programs, robots last, with time in planned steps: accelerations are in m and rad per step².

    Attributes:
        weights: of positions and velocities.
        effect: (H, 6, 4, 3, N) G; zero for feet that do not push.
        lean: (H, 6, N) slope of the cost by the accelerations.
        gravity: (6, 1) what the forces are to make beside the planned accelerations.
        pushes: (H, 4, 1, N) 1 for feet that push, else 0.
        number: (N,) of bounds that are in force.
    """

    weights: riccati.Weights
    effect: jax.Array
    lean: jax.Array
    gravity: jax.Array
    pushes: jax.Array
    number: jax.Array


Newton = Callable[[jax.Array], Point]


def make_solver(mpc: Mpc, iterations: int = ITERATIONS, floor: float = FLOOR) -> Solver:
    """A solver for programs of JAX arrays; `jax.vmap` of it, and a vmap of that, solves all of them together."""

    def many(*program: jax.Array) -> Solution:
        solved = _solve(mpc, iterations, floor, Problem(*(jp.moveaxis(x, 0, -1) for x in program)))
        return Solution(*(jp.moveaxis(x, -1, 0) for x in solved))

    return lambda program: together(many)(*program)


def _fold(combine: Callable[..., jax.Array], array: jax.Array) -> jax.Array:
    """All but the last axis combined, by halves: XLA's own reduction would not vectorise over the last."""
    flat = array.reshape(-1, array.shape[-1])
    while flat.shape[0] > 1:
        half, odd = divmod(flat.shape[0], 2)
        flat = jp.concatenate(
            [combine(flat[:half], flat[half : 2 * half]), flat[2 * half :]]
            if odd
            else [combine(flat[:half], flat[half:])]
        )
    return flat[0]


def _terms(mpc: Mpc, program: Problem) -> Terms:
    kind, dt = program.gradient.dtype, mpc.dt
    pushes = program.pushes.astype(kind)[:, :, None]
    gravity = np.array([0, 0, 0, 0, 0, GRAVITY * dt**2], kind)[:, None]
    stiff = np.array(mpc.attitude + mpc.position) / mpc.force
    damp = np.array(mpc.spin + mpc.velocity) / (mpc.force * dt**2)
    return Terms(
        weights=riccati.Weights(jp.asarray(stiff, kind), jp.asarray(damp, kind)),
        effect=dt**2 * program.effect * pushes[:, None],
        lean=jp.moveaxis(program.gradient, 1, 0) / (mpc.force * dt**2),
        gravity=jp.asarray(gravity),
        pushes=pushes,
        number=jp.maximum(pyramid.ROWS * _fold(jp.add, pushes), 1),
    )


def _start(mpc: Mpc, program: Problem, pushes: jax.Array) -> Point:
    """The weight borne by the pushing feet alike, all bounds kept; feet that do not push have no bounds."""
    least, most = mpc.least * program.weight, mpc.most * program.weight
    count = jp.maximum(add_up(pushes[:, i, 0] for i in range(pushes.shape[1])), 1)
    up = jp.clip(program.weight / count, 1.2 * least + 1.0, 0.9 * most)
    zero = jp.zeros_like(up)
    forces = jp.stack([zero, zero, up], axis=1)[:, None] * pushes
    slack = jp.where(pushes > 0, pyramid.bounds(least, most) - pyramid.rows(mpc.friction, forces), 1.0)
    return Point(forces, slack, START / slack * pushes)


def _push(effect: jax.Array, forces: jax.Array) -> jax.Array:
    """G f: (H, 6, N)."""
    return add_up(effect[:, :, i, j] * forces[:, i, j][:, None] for i in range(4) for j in range(3))


def _pull(effect: jax.Array, costs: jax.Array) -> jax.Array:
    """Gᵀ y: (H, 4, 3, N)."""
    return add_up(effect[:, d] * costs[:, d, None, None] for d in range(6))


def _amiss(mpc: Mpc, barrier: FusionBarrier, terms: Terms, point: Point) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The cost's slope (H, 4, 3, N), all complementarity (N,), and the bound (N,) on what forces are off."""
    made = barrier(lambda: _push(terms.effect, point.forces) - terms.gravity)
    costs = riccati.curved(terms.weights, made)
    pulled = barrier(lambda: _pull(terms.effect, costs + terms.lean))
    slope = barrier(lambda: point.forces + pulled)
    gradient = barrier(lambda: slope + pyramid.transposed(mpc.friction, point.price))
    total = barrier(lambda: _fold(jp.add, point.slack * point.price))
    bound = barrier(lambda: jp.sqrt(_fold(jp.add, gradient * gradient)) + jp.sqrt(2 * total))
    return slope, total, bound


def _newton(mpc: Mpc, barrier: FusionBarrier, terms: Terms, point: Point, slope: jax.Array) -> Newton:
    """The way to where the gradient vanishes and slack · price is less than none by a given amount (H, 4, 6, N)."""
    G, (_, slack, price) = terms.effect, point
    block = barrier(lambda: pyramid.block(mpc.friction, price / slack))
    K = barrier(pyramid.inverse, block)
    GK = barrier(lambda: add_up(G[:, :, :, k, None] * K[:, None, :, k] for k in range(3)))
    effects = barrier(lambda: add_up(GK[:, :, None, i, j] * G[:, None, :, i, j] for i in range(4) for j in range(3)))
    factors = riccati.factor(barrier, terms.weights, effects)

    def direction(more: jax.Array) -> Point:
        wanted = barrier(lambda: pyramid.transposed(mpc.friction, more / slack) - slope)
        costs = riccati.solve(barrier, factors, effects, barrier(lambda: _push(GK, wanted)))
        forces, rows = barrier(lambda: pyramid.solve(mpc.friction, block, wanted - _pull(G, costs)))
        change = -rows * terms.pushes
        return Point(forces, change, barrier(lambda: -price - (more + price * change) / slack))

    return direction


def _far(values: jax.Array, change: jax.Array) -> jax.Array:
    """(N,) how many times the change can be added before a value is 0."""
    shrinks = change < 0
    return _fold(jp.minimum, jp.where(shrinks, -values / jp.where(shrinks, change, -1.0), 1e9))


def _step(mpc: Mpc, barrier: FusionBarrier, terms: Terms, point: Point, amiss: Any, floor: float) -> Point:
    """One iteration."""
    slope, total, _ = amiss
    _, slack, price = point
    gap = total / terms.number
    direction = _newton(mpc, barrier, terms, point, slope)
    there = direction(jp.zeros_like(slack))

    def reached() -> jax.Array:
        some, more = (jp.minimum(1.0, _far(a, b)) for a, b in zip(point[1:], there[1:], strict=True))
        return _fold(jp.add, (slack + some * there.slack) * (price + more * there.price)) / terms.number

    after = barrier(reached)
    center = jp.maximum(jp.clip(after / jp.maximum(gap, SOLVED), 0.0, 1.0) ** 3 * gap, floor)
    change = direction(barrier(lambda: (there.slack * there.price - center) * terms.pushes))
    far = barrier(lambda: jp.minimum(_far(slack, change.slack), _far(price, change.price)))
    size = jp.minimum(1.0, STAY * far)
    return barrier(lambda: Point(*(a + size * b for a, b in zip(point, change, strict=True))))


def _solve(mpc: Mpc, iterations: int, floor: float, program: Problem) -> Solution:
    """Programs with the robots on the last axis of every argument."""
    terms = _terms(mpc, program)
    start = _start(mpc, program, terms.pushes)

    def better(barrier: FusionBarrier, point: Point, best: tuple[jax.Array, jax.Array]) -> tuple[Any, tuple[Any, Any]]:
        amiss = _amiss(mpc, barrier, terms, point)
        nearer = amiss[2] < best[1]
        return amiss, (jp.where(nearer, point.forces, best[0]), jp.where(nearer, amiss[2], best[1]))

    def body(i: jax.Array, carry: tuple[Point, Any]) -> tuple[Point, Any]:
        barrier, (point, best) = FusionBarrier(i >= 0), carry
        amiss, best = better(barrier, point, best)
        return _step(mpc, barrier, terms, point, amiss, floor), best

    worst = jp.full_like(program.weight, jp.inf)
    point, best = jax.lax.fori_loop(0, iterations, body, (start, (start.forces, worst)))
    forces, bound = better(FusionBarrier(), point, best)[1]
    return Solution(forces * terms.pushes, bound < TOLERANCE, jp.full(bound.shape, iterations, jp.int32))
