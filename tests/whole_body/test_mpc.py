"""The quadratic program against the motion that it plans, step by step, and its matrices against numerical ones."""

import dataclasses

import numpy as np
import pytest

from loco_mjx.whole_body import controller, library, mpc
from loco_mjx.whole_body.config import Mpc
from tests.whole_body.walks import BODY, CONFIG, model, recorded, walk

MPC = Mpc()


def made(seed=0, pushes=None):
    """A program, and the pose, rates and command that it is of."""
    random = np.random.default_rng(seed)
    pose = np.array([*random.uniform(-0.2, 0.2, 2), 0, 0, 0, 0.25])
    rates, command = random.uniform(-0.5, 0.5, 6), np.array([0.3, -0.2])
    effect = random.normal(size=(6, 4, 3)) * np.array([3, 3, 3, 0.08, 0.08, 0.08])[:, None, None]
    pushes = random.random((MPC.horizon, 4)) < 0.6 if pushes is None else pushes
    program = mpc.Problem(mpc.gradient(MPC, pose, rates, command, 0.24), effect, pushes, np.float64(122.0))
    return program, pose, rates, command


def planned_cost(program, pose, rates, command, forces):
    """The cost of forces (H, 4, 3), by moving the trunk through the horizon under constant accelerations."""
    place, speed = pose.copy(), rates.copy()
    stiff, damp = np.array(MPC.attitude + MPC.position), np.array(MPC.spin + MPC.velocity)
    wanted = np.array([0, 0, 0, 0, 0, 0.24])
    moving = np.array([0, 0, command[1], command[0], 0, 0])
    cost = 0.0
    for step in range(MPC.horizon):
        f = forces[step] * program.pushes[step][:, None]
        acceleration = np.einsum("dlx,lx->d", program.effect, f) - np.array([0, 0, 0, 0, 0, mpc.GRAVITY])
        place, speed = place + MPC.dt * speed + 0.5 * MPC.dt**2 * acceleration, speed + MPC.dt * acceleration
        goal = wanted + moving * (step + 1) * MPC.dt
        cost += 0.5 * stiff @ (place - goal) ** 2 + 0.5 * damp @ (speed - moving) ** 2 + 0.5 * MPC.force * np.sum(f**2)
    return cost / MPC.force


@pytest.mark.parametrize("seed", range(4))
def test_the_programs_cost_is_that_of_the_planned_motion(seed):
    program, *rest = made(seed)
    dense, random = library.dense(MPC, program), np.random.default_rng(seed)
    first, second = random.normal(size=(2, MPC.horizon, 4, 3)) * 50
    gap = planned_cost(program, *rest, first) - planned_cost(program, *rest, second)
    assert library.cost(dense, first) - library.cost(dense, second) == pytest.approx(gap, rel=1e-9)


def test_forces_at_feet_push_and_turn_the_trunk():
    """Up at the front left foot: it rises, its left side goes up (roll > 0), its nose goes up (pitch < 0)."""
    feet = np.array([[0.18, -0.13, -0.25], [0.18, 0.13, -0.25], [-0.18, -0.13, -0.25], [-0.18, 0.13, -0.25]])
    effect = mpc.effect(BODY, np.eye(3), feet)
    roll, pitch, _, _, _, up = effect[:, 1] @ [0, 0, 1.0]
    assert roll > 0 and pitch < 0 and up == pytest.approx(1 / BODY.mass)
    np.testing.assert_allclose(effect[3:, 2] * BODY.mass, np.eye(3))


def test_standing_still_asks_for_the_weight():
    feet = np.array([[0.18, -0.13, -0.24], [0.18, 0.13, -0.24], [-0.18, -0.13, -0.24], [-0.18, 0.13, -0.24]])
    rest = np.array([0, 0, 0, 0, 0, 0.24])
    cheap = dataclasses.replace(MPC, force=1e-9)  # else later forces are saved on, and the first makes up for it
    program = mpc.Problem(
        mpc.gradient(cheap, rest, np.zeros(6), np.zeros(2), 0.24),
        mpc.effect(BODY._replace(center=np.zeros(3)), np.eye(3), feet),
        np.ones((MPC.horizon, 4), bool),
        np.float64(BODY.mass * mpc.GRAVITY),
    )
    forces = library.make_solver(cheap)(program).forces
    np.testing.assert_allclose(forces[:5, :, 2].sum(axis=1), BODY.mass * mpc.GRAVITY, rtol=0.01)
    np.testing.assert_allclose(forces[:, :, :2], 0.0, atol=0.5)


def test_torques_make_the_forces():
    """A robot that stands on four feet under the controller's torques alone presses as was planned."""
    done = walk(model(), lambda time: (0.0, 0.0), 0.04)  # before the first leg swings
    last = done.ticks[-1]
    assert last.facts.pushes.all() and not last.told.kp.any()
    # A leg's own weight, 1.9 kg and more of it near the trunk, is not in the program.
    assert np.abs(done.poses[-1, 2] - done.poses[0, 2]) < 0.01


def test_limits_hold_in_every_recorded_program():
    solve = library.make_solver(MPC)
    for seen in recorded()[::25]:
        sensed = controller.sense(BODY, seen.state, seen.measured, controller.gait.Mode(*seen.facts[3:]))
        program = controller.program(CONFIG, BODY, sensed, seen.state.tick * 0.005, seen.facts.pushes, seen.command)
        forces, weight = solve(program).forces, float(program.weight)
        x, y, z = (forces[program.pushes][:, i] for i in range(3))
        slack = 1e-6 * weight
        assert np.all(np.abs(x) <= MPC.friction * z + slack) and np.all(np.abs(y) <= MPC.friction * z + slack)
        assert np.all(z >= MPC.least * weight - slack) and np.all(z <= MPC.most * weight + slack)
        assert not forces[~program.pushes].any()
