"""Newton's direction of the forces' quadratic program, by Riccati's recursion over the horizon.

The accelerations drive six double integrators, which cost only where they are; so instead of one system of
6 · horizon equations there is one of six for every planned step. Arrays have their components first and the N robots
last, which is what vectorises. Time is in planned steps here, so that positions and velocities are both in m and rad.

Along the recursion the cost from a step on is ½ xᵀ P x + pᵀ x, with x = (q, v) the positions and velocities there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics.xla import FusionBarrier, add_up

Pair = tuple[jax.Array, jax.Array]  # of positions and of velocities, (6, N) each


class Weights(NamedTuple):
    """What being off costs, by the squared position and velocity of each degree of freedom.

    Attributes:
        position: (6,).
        velocity: (6,).
    """

    position: jax.Array
    velocity: jax.Array


def curved(weights: Weights, accelerations: jax.Array) -> jax.Array:
    """(H, 6, N) S d, the slope of the states' cost at accelerations d (H, 6, N), from rest."""

    def on(state: Pair, a: jax.Array) -> tuple[Pair, Pair]:
        q, v = state
        state = (q + v + 0.5 * a, v + a)
        return state, state

    def back(price: Pair, state: Pair) -> tuple[Pair, jax.Array]:
        q, v = price[0] + weights.position[:, None] * state[0], price[1] + weights.velocity[:, None] * state[1]
        return (q, q + v), 0.5 * q + v

    rest = (jp.zeros_like(accelerations[0]),) * 2
    states = jax.lax.scan(on, rest, accelerations)[1]
    return jax.lax.scan(back, rest, states, reverse=True)[1]


class Factors(NamedTuple):
    """One step's part of the factorisation.

    Attributes:
        gain: (6, 6, N) T = (I + W E)⁻¹.
        drive: (6, 6, N) Z = T W = (W⁻¹ + E)⁻¹.
        costs: (6, 12, N) Bᵀ P A, for positions and for velocities.
    """

    gain: jax.Array
    drive: jax.Array
    costs: jax.Array


def mm(a: jax.Array, b: jax.Array) -> jax.Array:
    """Matrix product of (i, k, N) and (k, j, N)."""
    return add_up(a[:, k, None] * b[k] for k in range(a.shape[1]))


def mtm(a: jax.Array, b: jax.Array) -> jax.Array:
    """Product of the transposed (k, i, N) and (k, j, N)."""
    return add_up(a[k][:, None] * b[k] for k in range(a.shape[0]))


def mv(a: jax.Array, x: jax.Array) -> jax.Array:
    """Product of (i, k, N) and (k, N)."""
    return add_up(a[:, k] * x[k] for k in range(a.shape[1]))


def mtv(a: jax.Array, x: jax.Array) -> jax.Array:
    """Product of the transposed (k, i, N) and (k, N)."""
    return add_up(a[k] * x[k] for k in range(a.shape[0]))


def flip(a: jax.Array) -> jax.Array:
    """Transposed (i, k, N)."""
    return a.swapaxes(0, 1)


def inverse3(a: jax.Array) -> jax.Array:
    """Inverse of symmetric (3, 3, N), by its adjugate."""
    xx, xy, xz, yy, yz, zz = a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2]
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d = 1 / (xx * c0 + xy * c1 + xz * c2)
    c4, c5, c8 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return jp.stack([jp.stack([c0, c1, c2]), jp.stack([c1, c4, c5]), jp.stack([c2, c5, c8])]) * d


def inverse6(barrier: FusionBarrier, a: jax.Array) -> jax.Array:
    """Inverse of symmetric positive (6, 6, N), by blocks of three."""
    first, second = barrier(lambda: (inverse3(a[:3, :3]), a[:3, 3:]))
    side = barrier(mm, first, second)
    rest = barrier(lambda: inverse3(a[3:, 3:] - mtm(second, side)))
    corner = barrier(lambda: -mm(side, rest))
    return barrier(
        lambda: jp.concatenate(
            [
                jp.concatenate([first - mm(corner, flip(side)), corner], axis=1),
                jp.concatenate([flip(corner), rest], axis=1),
            ]
        )
    )


def factor(barrier: FusionBarrier, weights: Weights, effects: jax.Array) -> Factors:
    """The factorisation.

    Args:
        barrier: how to compute intermediate results once.
        weights: of the states.
        effects: (H, 6, 6, N) E = G K⁻¹ Gᵀ of each step.
    """
    n, kind = effects.shape[-1], effects.dtype
    eye = jp.eye(6, dtype=kind)[:, :, None]
    place, speed = eye * weights.position[:, None, None], eye * weights.velocity[:, None, None]
    zero = jp.zeros((6, 6, n), kind)

    def back(P: tuple[jax.Array, jax.Array, jax.Array], E: jax.Array) -> tuple[Any, Factors]:
        qq, qv, vv = P

        def ahead() -> tuple[jax.Array, jax.Array, jax.Array]:
            by_q, by_v = 0.5 * qq + qv, 0.5 * flip(qv) + vv  # P B
            return 0.5 * by_q + by_v, flip(by_q), flip(by_v) + flip(by_q)

        W, left, right = barrier(ahead)
        inverse = inverse6(barrier, W)
        Z = inverse6(barrier, inverse + E)
        gain = barrier(mm, Z, inverse)
        X = barrier(mm, E, gain)
        XH = barrier(lambda: (mm(X, left), mm(X, right)))

        def onto() -> tuple[jax.Array, jax.Array, jax.Array]:
            new_qq = qq - mtm(left, XH[0]) + place
            new_qv = qv + qq - mtm(left, XH[1])
            new_vv = vv + qv + flip(qv) + qq - mtm(right, XH[1]) + speed
            return 0.5 * (new_qq + flip(new_qq)), new_qv, 0.5 * (new_vv + flip(new_vv))

        return barrier(onto), Factors(gain, Z, jp.concatenate([left, right], axis=1))

    last = (place + zero, zero, speed + zero)
    return jax.lax.scan(back, last, effects, reverse=True)[1]


def solve(barrier: FusionBarrier, factors: Factors, effects: jax.Array, free: jax.Array) -> jax.Array:
    """(H, 6, N) λ: what the states' cost asks of each step's acceleration, S d.

    Args:
        barrier: how to compute intermediate results once.
        factors: from :func:`factor`.
        effects: (H, 6, 6, N) E.
        free: (H, 6, N) the accelerations if states cost nothing, G K⁻¹ r.
    """

    def back(p: Pair, at: Any) -> tuple[Any, jax.Array]:
        (gain, drive, costs), E, u = at
        pq, pv = p

        def one() -> Pair:
            push = 0.5 * pq + pv  # Bᵀ p
            return push, mv(drive, u) + mv(gain, push)

        push, price = barrier(one)

        def two() -> Pair:
            pull = mtv(costs, u - mv(E, price))  # Hᵀ u = Aᵀ P B u
            return pq + pull[:6], pq + pv + pull[6:]

        return barrier(two), push

    zero = jp.zeros_like(free[0])
    pushes = jax.lax.scan(back, (zero, zero), (factors, effects, free), reverse=True)[1]

    def on(x: Pair, at: Any) -> tuple[Any, jax.Array]:
        (gain, drive, costs), E, u, push = at
        q, v = x
        h = barrier(lambda: push + mv(costs, jp.concatenate([q, v])))
        price = barrier(lambda: mv(drive, u) + mv(gain, h))
        a = u - mv(E, price)
        return barrier(lambda: (q + v + 0.5 * a, v + a)), price

    return jax.lax.scan(on, (zero, zero), (factors, effects, free, pushes))[1]
