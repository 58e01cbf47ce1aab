"""The quadratic program solved by a library, without JAX: on robots, and as what solver.py is compared with.

quadprog's dual active-set method (Goldfarb and Idnani, 1983) is exact to rounding and ends after finitely many steps;
of the libraries compared it was the fastest on these programs (docs/whole_body.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loco_mjx.errors import UserError
from loco_mjx.whole_body.config import Mpc
from loco_mjx.whole_body.controller import Solution, Solver
from loco_mjx.whole_body.mpc import GRAVITY, Problem, plan


class Dense(NamedTuple):
    """A program of n forces' components: the least ½ fᵀ P f + qᵀ f with A f ≤ b, in units of the weight on forces.

    Attributes:
        P: (n, n).
        q: (n,).
        A: (2 n, n).
        b: (2 n,).
        chosen: (horizon, 4) bool, the feet whose forces f holds, in this order, x, y and z of each.
    """

    P: np.ndarray
    q: np.ndarray
    A: np.ndarray
    b: np.ndarray
    chosen: np.ndarray


def dense(mpc: Mpc, program: Problem) -> Dense:
    """The program of the pushing feet alone, with the accelerations eliminated."""
    curvature = plan(mpc).curvature / mpc.force
    chosen = np.asarray(program.pushes, bool)
    step, leg = np.nonzero(chosen)
    n = 3 * len(step)
    effect = np.asarray(program.effect, np.float64)[:, leg].reshape(6, n)
    at = np.repeat(step, 3)
    P = np.eye(n)
    for one, block in zip(effect, curvature, strict=True):
        P += np.outer(one, one) * block[at[:, None], at]
    # With d = G f − g the linear term is Gᵀ (s − S g).
    slope = np.asarray(program.gradient, np.float64) / mpc.force
    slope[5] -= curvature[5].sum(axis=1) * GRAVITY
    q = np.sum(effect * slope[:, at], axis=0)
    mu, weight = mpc.friction, float(program.weight)
    foot = np.array([[1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu], [0, 0, -1], [0, 0, 1.0]])
    A = np.zeros((len(step), 6, len(step), 3))
    A[np.arange(len(step)), :, np.arange(len(step))] = foot
    b = np.tile([0.0, 0.0, 0.0, 0.0, -mpc.least * weight, mpc.most * weight], len(step))
    return Dense(P, q, A.reshape(2 * n, n), b, chosen)


def cost(program: Dense, forces: np.ndarray) -> float:
    """½ fᵀ P f + qᵀ f of forces (horizon, 4, 3), N."""
    f = forces[program.chosen].reshape(-1)
    return float(0.5 * f @ program.P @ f + program.q @ f)


def make_solver(mpc: Mpc) -> Solver:
    """A solver for programs of NumPy arrays.

    Raises:
        UserError: if quadprog is missing.
    """
    try:
        from quadprog import solve_qp
    except ImportError:
        raise UserError("the whole-body controller needs quadprog; `pip install 'loco-mjx[mpc]'` installs it") from None

    def solve(program: Problem) -> Solution:
        P, q, A, b, chosen = dense(mpc, program)
        forces = np.zeros((*chosen.shape, 3))
        if not np.all(np.isfinite(program.gradient)):
            return Solution(forces, np.bool_(False), np.int32(0))
        if not len(q):
            return Solution(forces, np.bool_(True), np.int32(0))
        try:
            found, _, _, counts, _, _ = solve_qp(P, -q, -A.T, -b)
        except ValueError:  # not positive definite, or nothing is feasible: rounding or a wrong measurement
            return Solution(forces, np.bool_(False), np.int32(0))
        forces[chosen] = found.reshape(-1, 3)
        return Solution(forces, np.bool_(np.all(np.isfinite(found))), np.int32(counts[0]))

    return solve
