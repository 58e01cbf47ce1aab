"""Physics under a controller: its ticks see the robot, and its commands are the motors' law."""

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.physics.driven import begin, driven_steps
from loco_mjx.physics.step import initial_state
from loco_mjx.robots.motor import MotorCommand
from tests.known_robots import A1
from tests.physics import world

TICKS, SUBSTEPS = 8, 2  # a control step of the A1
STEPS = 6


def hold(memory, physics, contacts):
    """Holds the targets in its memory by the A1's own gains, a part of it as torque; counts, and tells what it saw."""
    targets, count = memory
    gains = jp.full(12, A1.kp)
    # kp (targets − q) split in two: half of it about other angles, and a torque that makes up for that
    angles, torque = targets + 0.1, -A1.kp * 0.1 * jp.ones(12)
    command = MotorCommand(angles, jp.zeros(12), gains, jp.full(12, A1.kd), torque)
    return command, (targets, count + 1), (contacts, physics.qpos[2], count)


@pytest.fixture(scope="module")
def driven():
    """Robots that stand, drop from 0.3 m, and follow a target, under the controller: states, traces and facts."""
    model, flat = world.physics(), world.batch([world.scene()])
    starts = [world.standing(), world.standing(height=A1.stand_height + 0.3), world.standing(), world.standing()]
    targets = np.tile(np.array(A1.default_pose, np.float32), (4, 1))
    targets[2:] += 0.2
    one = lambda driven, scene, how: driven_steps(model, hold, driven, scene, how, TICKS, SUBSTEPS)  # noqa: E731
    step = jax.jit(jax.vmap(one))
    state = jax.vmap(lambda q, t: begin(initial_state(q), (t, jp.int32(0))))(jp.asarray(np.stack(starts)), targets)
    how = world.batch([world.nominal()])
    done = []
    for _ in range(STEPS):
        state, trace, facts = step(state, flat, how)
        done.append(jax.tree.map(np.asarray, (state, trace, facts)))
    return starts, targets, done


def test_the_motors_law_is_that_of_control_step(driven):
    """The same targets by control_step: gains and torque together are its PD law, in other arithmetic."""
    starts, targets, done = driven
    states, traces = world.rollout(starts, [world.scene()] * 4, np.repeat(targets[:, None], STEPS, axis=1))
    for step, (state, trace, _) in enumerate(done):
        np.testing.assert_allclose(state.physics.qpos, states.qpos[:, step], atol=2e-3)
        np.testing.assert_allclose(trace.angles, traces.angles[:, step], atol=2e-3)


def test_every_tick_sees_the_robot_as_it_is(driven):
    _, _, done = driven
    for step, (state, trace, (_, heights, counts)) in enumerate(done):
        assert trace.angles.shape == (4, TICKS * SUBSTEPS + 1, 12)
        np.testing.assert_array_equal(counts, np.tile(TICKS * step + np.arange(TICKS), (4, 1)))
        assert np.all(state.memory[1] == TICKS * (step + 1))
        assert len(set(heights[1].tolist())) == TICKS  # it falls


def test_feet_feel_what_they_touch(driven):
    _, _, done = driven
    standing = np.stack([facts[0][0] for _, _, facts in done])
    falling = np.stack([facts[0][1] for _, _, facts in done])
    assert standing.all() and not falling[:5].reshape(-1, 4)[1:].any()  # 0.3 m take 0.25 s; the first tick is a guess
