"""The JAX solver against quadprog, which is exact: 1,000 programs of walks, and degenerate ones."""

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.bench import mpc as bench
from loco_mjx.controllers import TICK
from loco_mjx.whole_body import controller, gait, library, mpc, solver
from loco_mjx.whole_body.arrays import level, rotation
from loco_mjx.whole_body.config import Mpc
from loco_mjx.whole_body.legs import feet
from tests.whole_body.walks import BODY, CONFIG, recorded

MPC = Mpc()
NEAR = 0.01  # N; a hundredth of what is asked for


def of_walks():
    programs = []
    for seen in recorded():
        sensed = controller.sense(BODY, seen.state, seen.measured, gait.Mode(*seen.facts[3:]))
        time = np.float64(seen.state.tick * TICK)
        programs.append(
            controller.program(CONFIG, BODY, sensed, time, seen.facts.pushes, controller.clip(seen.command))
        )
    return programs


def tilted(random, tilt):
    """A program of a robot that is falling over."""
    quat = np.array([1, *random.uniform(-tilt, tilt, 2), 0])
    pose, attitude = level(rotation(quat))
    angles = np.tile([0, 0.9, -1.8], 4) + random.uniform(-0.4, 0.4, 12)
    there = np.concatenate([pose, np.zeros(3), [random.uniform(0.15, 0.35)]])
    gradient = mpc.gradient(MPC, there, random.uniform(-2, 2, 6), random.choice([-1, 1], 2) * [0.4, 0.3], 0.24)
    effect = mpc.effect(BODY, attitude, feet(BODY, angles))
    return gradient, effect


def degenerate():
    """No feet, one, all but one, all, jumping; level, tilted by a radian; commands at the limits."""
    random = np.random.default_rng(5)
    tables = [np.zeros((10, 4), bool), np.ones((10, 4), bool), np.eye(4, dtype=bool)[np.zeros(10, int)]]
    tables += [~np.eye(4, dtype=bool)[np.ones(10, int)], np.tile(np.arange(10)[:, None] > 4, (1, 4))]
    tables += [random.random((10, 4)) < 0.5 for _ in range(15)]
    weight = np.float64(BODY.mass * mpc.GRAVITY)
    return [mpc.Problem(*tilted(random, tilt), table, weight) for tilt in (0.0, 0.1, 0.5) for table in tables]


@pytest.fixture(scope="module")
def solved():
    """Programs of walks, then degenerate ones; quadprog's solutions and ours, in one compilation."""
    programs = of_walks() + degenerate()
    single = jax.tree.map(lambda *x: jp.asarray(np.stack(x), bool if x[0].dtype == bool else jp.float32), *programs)
    ours = jax.jit(jax.vmap(solver.make_solver(MPC)))(single)
    exact = library.make_solver(MPC)
    return programs, [exact(program) for program in programs], jax.tree.map(np.asarray, ours)


def test_all_are_solved(solved):
    _, theirs, ours = solved
    assert len(theirs) >= 1060 and all(one.converged for one in theirs) and ours.converged.all()
    assert set(ours.iterations.tolist()) == {solver.ITERATIONS}


def test_forces_are_quadprogs(solved):
    _, theirs, ours = solved
    off = np.abs(ours.forces - np.stack([one.forces for one in theirs])).max(axis=(1, 2, 3))
    assert off[:1000].max() < NEAR, off[:1000].max()
    assert off.max() < 10 * NEAR, off.max()


def test_forces_are_osqps_or_the_cost_is(solved):
    """Within 1 N, or 0.1% of the cost: OSQP stops at a tolerance of its own."""
    pytest.importorskip("osqp")
    programs, _, ours = solved
    by_osqp = bench.solvers(CONFIG)["osqp"]
    for program, forces in zip(programs, ours.forces.astype(np.float64), strict=True):
        dense = library.dense(MPC, program)
        if len(dense.q):
            theirs = np.zeros_like(forces)
            theirs[dense.chosen] = by_osqp(dense).x.reshape(-1, 3)
            best = library.cost(dense, theirs)
            assert np.abs(forces - theirs).max() < 1.0 or library.cost(dense, forces) <= best + 1e-3 * abs(best)


def test_the_cost_is_not_above_quadprogs(solved):
    programs, theirs, ours = solved
    for program, exact, forces in zip(programs[::20], theirs[::20], ours.forces[::20], strict=True):
        dense = library.dense(MPC, program)
        if len(dense.q):
            best = library.cost(dense, exact.forces)
            assert library.cost(dense, forces.astype(np.float64)) <= best + 1e-3 * abs(best)


def test_feet_in_the_air_do_not_push(solved):
    programs, _, ours = solved
    for program, forces in zip(programs, ours.forces, strict=True):
        assert not forces[~program.pushes].any()


def test_what_is_not_solved_is_said(solved):
    """Too few iterations, and a measurement that is no number: both are found out, neither takes others along."""
    programs = degenerate()[:8]
    broken = programs[0]._replace(gradient=np.full((6, 10), np.nan))
    stacked = jax.tree.map(
        lambda *x: jp.asarray(np.stack(x), bool if x[0].dtype == bool else jp.float32), *programs, broken
    )
    few = jax.jit(jax.vmap(solver.make_solver(MPC, iterations=2)))(stacked)
    assert not few.converged[1:].any() and np.isfinite(np.asarray(few.forces)[:-1]).all()
    assert not library.make_solver(MPC)(broken).converged
