"""One tick: in JAX as in NumPy, and what it does with what is wrong."""

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.controllers import SPEED_LIMIT, YAW_RATE_LIMIT
from loco_mjx.whole_body import controller, library, solver
from tests.whole_body.walks import BODY, CONFIG, Seen, recorded

SAME = 1e-4  # N·m


def single(tree):
    return jax.tree.map(lambda x: jp.asarray(x, jp.float32 if np.asarray(x).dtype == np.float64 else None), tree)


def rounded(tree):
    """Numbers that float32 has, too."""
    fits = lambda x: np.asarray(x).astype(np.float32).astype(np.float64)  # noqa: E731
    return jax.tree.map(lambda x: fits(x) if np.asarray(x).dtype == np.float64 else x, tree)


@pytest.fixture(scope="module")
def both():
    """Recorded ticks, rounded to float32, and what the compiled controller makes of the same."""
    solve, exact = solver.make_solver(CONFIG.mpc), library.make_solver(CONFIG.mpc)
    compiled = jax.jit(jax.vmap(lambda *args: controller.tick(CONFIG, BODY, solve, *args)))
    ticks = []
    for one in recorded():
        given = rounded((one.state, one.command, one.measured))
        ticks.append(Seen(*given, *controller.tick(CONFIG, BODY, exact, *given)))
    stacked = single(jax.tree.map(lambda *x: np.stack(x), *[(one.state, one.command, one.measured) for one in ticks]))
    return ticks, jax.tree.map(np.asarray, compiled(*stacked))


def test_jax_and_numpy_command_the_same(both):
    """In float32, of robots that are pushed with 90 N and ordered beyond the limits."""
    ticks, (told, _, _) = both
    for name, ours in told._asdict().items():
        theirs = np.stack([getattr(one.told, name) for one in ticks])
        if name == "torque":
            off = np.abs(ours - theirs)
            assert np.quantile(off, 0.999) < SAME and off.max() < 3 * SAME, off.max()
        else:
            np.testing.assert_allclose(ours, theirs, atol=2e-5, err_msg=name)


def test_jax_and_numpy_carry_and_say_the_same(both):
    ticks, (_, after, facts) = both
    for name, ours in after._asdict().items():
        theirs = np.stack([getattr(one.after, name) for one in ticks])
        np.testing.assert_allclose(ours, theirs, atol=1e-3 if name == "forces" else 1e-6, err_msg=name)
    for name, ours in facts._asdict().items():
        if name != "iterations":
            np.testing.assert_array_equal(ours, np.stack([getattr(one.facts, name) for one in ticks]), err_msg=name)
    assert facts.clipped.any() and not facts.clipped.all() and facts.early.any() and facts.lost.any()


def with_command(seen, command, solve):
    return controller.tick(CONFIG, BODY, solve, seen.state, np.array(command, float), seen.measured)


def test_commands_beyond_the_limits_are_clipped_and_said():
    solve, seen = library.make_solver(CONFIG.mpc), recorded()[40]
    beyond, _, said = with_command(seen, (7.0, -3.0), solve)
    at, _, unsaid = with_command(seen, (SPEED_LIMIT, -YAW_RATE_LIMIT), solve)
    np.testing.assert_array_equal(beyond.torque, at.torque)
    assert said.clipped and not unsaid.clipped


def test_a_program_that_fails_is_counted_and_the_last_forces_stand_in():
    seen = recorded()[40]

    def fails(program):
        return controller.Solution(np.full((10, 4, 3), 99.0), np.bool_(False), np.int32(0))

    told, after, facts = with_command(seen, (0.3, 0.0), fails)
    assert facts.unsolved and after.failed == seen.state.failed + 1
    np.testing.assert_array_equal(after.forces, seen.state.forces)
    exact = library.make_solver(CONFIG.mpc)
    again = controller.tick(CONFIG, BODY, fails, after, np.array([0.3, 0.0]), seen.measured)
    assert again[1].failed == after.failed + 1
    good = controller.tick(CONFIG, BODY, exact, again[1], np.array([0.3, 0.0]), seen.measured)
    assert good[1].failed == 0 and not good[2].unsolved
    assert np.all(np.isfinite(told.torque))


def test_a_measurement_that_is_no_number_reaches_no_forces():
    seen = recorded()[40]
    broken = seen._replace(measured=seen.measured._replace(velocity=np.full(3, np.nan)))
    _, after, facts = with_command(broken, (0.3, 0.0), library.make_solver(CONFIG.mpc))
    assert facts.unsolved and np.all(np.isfinite(after.forces))


def test_torques_stay_within_the_motors():
    assert all(np.abs(one.told.torque).max() <= BODY.torque.max() for one in recorded())
