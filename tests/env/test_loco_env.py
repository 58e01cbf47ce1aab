"""The environment as a whole: mapping of actions, histories, endings, containment, autoreset."""

import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx import make_env
from loco_mjx.config import ActionConfig, DepthConfig, EnvConfig, ObservationConfig, RandomizationConfig
from loco_mjx.env import autoreset
from loco_mjx.env.drive import Moved
from loco_mjx.errors import UnknownNameError
from loco_mjx.physics.step import SubstepTrace
from tests.known_robots import A1
from tests.light import LIGHT
from tests.refusals import refusal

HORIZON = 6
BLIND = ObservationConfig(depth=DepthConfig(enabled=False))


@pytest.fixture(scope="session")
def env():
    return make_env("thin", horizon=HORIZON)


@pytest.fixture(scope="session")
def reset(env):
    return jax.jit(env.reset)


@pytest.fixture(scope="session")
def step(env):
    return jax.jit(env.step)


@pytest.fixture(scope="session")
def auto():
    """(pool, first, step) of the autoreset, batched over 3 environments."""
    env = make_env("thin", config=EnvConfig(physics=LIGHT, horizon=HORIZON))
    pool = env.make_pool(jax.random.PRNGKey(5), 4)
    first = jax.jit(jax.vmap(lambda k: autoreset.first(env, k, pool)))
    step = jax.jit(jax.vmap(lambda s, a: autoreset.step(env, s, a, pool)))
    return pool, first, step


@pytest.fixture(scope="session")
def other():
    """(env, reset of 200, step of one): diagonal actions, no depth, randomised."""
    config = EnvConfig(
        observation=BLIND,
        action=ActionConfig(scale=(0.1, 0.2, 0.3), diagonal=True),
        randomization=RandomizationConfig(enabled=True),
        physics=LIGHT,
    )
    env = make_env("thin", config=config)
    reset = jax.jit(lambda key: jax.vmap(env.reset)(jax.random.split(key, 200)))
    return env, reset, jax.jit(env.step)


def _edit(state, **physics):
    world = state.pipeline_state
    return state.replace(pipeline_state=world.replace(physics=world.physics.replace(**physics)))


def test_shapes_and_first_state(env, reset, key):
    state = reset(key)
    assert {k: v.shape for k, v in state.obs.items()} == {"state": (93,), "pixels/depth": (64, 64, 4)}
    assert env.observation_size == {"state": (93,), "pixels/depth": (64, 64, 4)} and env.action_size == 12
    qpos = np.array(state.pipeline_state.physics.qpos)
    assert np.abs(qpos[:2]).max() <= 1.0 and qpos[2] == pytest.approx(A1.stand_height)
    np.testing.assert_allclose(qpos[3:7], [1, 0, 0, 0])
    frames = np.array(state.obs["pixels/depth"])
    assert (frames == frames[..., :1]).all() and np.ptp(frames) > 0.5
    assert float(state.done) == 0 and float(state.reward) == 0


def test_observation_after_a_step_is_what_happened(reset, step, key):
    state = reset(key)
    action = jp.linspace(-1, 1, 12)
    after = step(state, action)
    moved = after.pipeline_state.physics.qpos[:3] - state.pipeline_state.physics.qpos[:3]
    obs = np.array(after.obs["state"])
    np.testing.assert_allclose(obs[:3], moved, atol=1e-6)
    assert not obs[3:9].any()
    np.testing.assert_allclose(obs[21:33], 0.5 * np.linspace(-1, 1, 12), atol=1e-6)
    np.testing.assert_allclose(obs[57:69], after.pipeline_state.physics.qpos[7:], atol=1e-6)
    np.testing.assert_allclose(obs[69:81], A1.default_pose, atol=1e-6)
    terms = sum(float(v) for k, v in after.metrics.items() if k.startswith("reward/"))
    assert float(after.reward) == pytest.approx(terms, abs=1e-5)
    assert float(after.metrics["distance"]) == pytest.approx(float(moved[0]), abs=1e-6)
    np.testing.assert_array_equal(after.obs["pixels/depth"][..., 1:], state.obs["pixels/depth"][..., :3])


def test_actions_outside_the_range_are_clipped(reset, step, key):
    state = reset(key)
    beyond, edge = step(state, 5.0 * jp.ones(12)), step(state, jp.ones(12))
    np.testing.assert_array_equal(beyond.pipeline_state.physics.qpos, edge.pipeline_state.physics.qpos)


def test_diagonal_legs_share_their_targets(other, key):
    env, reset, step = other
    state = step(jax.tree.map(lambda x: x[0], reset(key)), jp.array([1.0, -1.0, 1.0, 0.5, 0.5, -0.5]))
    right, left = [0.1, -0.2, 0.3], [0.05, 0.1, -0.15]
    np.testing.assert_allclose(state.pipeline_state.episode.last_action, right + left + left + right, atol=1e-6)
    assert env.action_size == 6 and set(state.obs) == {"state"}


def test_a_fallen_robot_ends_the_episode_without_truncation(reset, step, key):
    state = reset(key)
    tilted = _edit(state, qpos=state.pipeline_state.physics.qpos.at[3:7].set(jp.array([0.5, 0.866, 0.0, 0.0])))
    low = _edit(state, qpos=state.pipeline_state.physics.qpos.at[2].add(-0.16))
    for broken in (tilted, low):
        after = step(broken, jp.zeros(12))
        assert float(after.done) == 1 and float(after.info["truncation"]) == 0


def test_the_horizon_truncates(reset, step, key):
    state = reset(key)
    for i in range(HORIZON):
        assert float(state.done) == 0, i
        state = step(state, jp.zeros(12))
    assert float(state.done) == 1 and float(state.info["truncation"]) == 1


def test_a_non_finite_state_is_counted_and_contained(reset, step, key):
    state = reset(key)
    broken = _edit(state, qvel=state.pipeline_state.physics.qvel.at[3].set(jp.nan))
    after = step(broken, jp.zeros(12))
    assert float(after.done) == 1 and float(after.info["truncation"]) == 0 and float(after.metrics["nonfinite"]) == 1
    assert np.isfinite(float(after.reward))
    assert all(np.isfinite(np.array(x)).all() for x in jax.tree.leaves(after.obs))


def test_the_step_after_done_starts_a_new_episode(auto):
    pool, first, step = auto
    state = first(jax.random.split(jax.random.PRNGKey(3), 3))
    np.testing.assert_array_equal(state.info["reset"], 1)
    returns = np.zeros(3)
    for _ in range(HORIZON):
        state = step(state, jp.zeros((3, 12)))
        returns += np.array(state.reward)
    np.testing.assert_array_equal(state.done, 1)
    np.testing.assert_allclose(state.info["episode"]["return"], returns, rtol=1e-5)
    np.testing.assert_array_equal(state.info["episode"]["length"], HORIZON)
    terminal = state.obs["state"]
    fresh = step(state, jp.ones((3, 12)))
    np.testing.assert_array_equal(fresh.info["reset"], 1)
    np.testing.assert_array_equal(fresh.done, 0)
    np.testing.assert_array_equal(fresh.reward, 0)
    np.testing.assert_array_equal(fresh.pipeline_state.episode.step, 0)
    assert not np.allclose(fresh.obs["state"], terminal)
    stack = np.array(fresh.obs["pixels/depth"])
    assert (stack == stack[..., :1]).all()  # nothing of the old episode is left in the stack
    running = step(fresh, jp.zeros((3, 12)))
    np.testing.assert_array_equal(running.info["reset"], 0)
    np.testing.assert_array_equal(running.info["episode"]["length"], 1)
    centres = np.array(pool.boxes.center)
    for i in range(3):  # every new scene is one of the pool's
        assert (np.abs(centres - np.array(fresh.pipeline_state.scene.boxes.center[i])).max(axis=(1, 2)) == 0).any()


def test_randomization_draws_within_its_ranges_and_stays_for_the_episode(other, key):
    env, reset, step = other
    states = reset(key)
    drawn = states.pipeline_state.randomization
    for values, low, high in [
        (drawn.dynamics.kp, 40, 90),
        (drawn.dynamics.kd, 0.4, 0.8),
        (drawn.dynamics.friction, 0.5, 1.25),
        (drawn.dynamics.motor_strength, 0.8, 1.2),
        (drawn.dynamics.mass, 0.8, 1.2),
        (drawn.dynamics.inertia, 0.5, 1.5),
        (drawn.dynamics.motor_friction, 0.0, 0.05),
        (drawn.latency, 0.0, 0.04),
    ]:
        span = high - low
        assert low <= float(values.min()) < low + 0.1 * span and high - 0.1 * span < float(values.max()) <= high
    one = jax.tree.map(lambda x: x[0], states)
    after = step(one, jp.zeros(env.action_size))
    assert float(after.pipeline_state.randomization.dynamics.kp) == float(one.pipeline_state.randomization.dynamics.kp)


def test_depth_noise_follows_randomization_unless_told():
    noisy = dataclasses.replace(EnvConfig(), randomization=RandomizationConfig(enabled=True))
    frames = []
    for config in (EnvConfig(), noisy):
        env = make_env("thin", config=config)
        state = jax.jit(env.reset)(jax.random.PRNGKey(0))
        frames.append(np.array(state.obs["pixels/depth"][..., 0]))
    changed = (frames[0] != frames[1]).sum()
    assert 1 <= changed <= 30


def test_an_unknown_task_is_named():
    with refusal("task thn thin", UnknownNameError):
        make_env("thn")


def _unmoved(physics, dropped=0):
    """A control step after which the robot is in this state."""
    zero = jp.zeros(())
    trace = [jp.tile(x, (17, 1)) for x in (physics.qpos[7:], physics.qpos[3:7], physics.qvel[3:6])]
    return Moved(physics, None, SubstepTrace(zero, zero > 0, jp.int32(dropped), *trace), {})


def test_what_physics_could_not_feel_is_a_metric(other):
    env, reset, _ = other
    state = jax.tree.map(lambda x: x[0], reset(jax.random.PRNGKey(0)))
    world = state.pipeline_state
    # At the origin, where a goal would be that is not there.
    physics = _edit(state, qpos=world.physics.qpos.at[:3].set(world.scene.goal)).pipeline_state.physics
    after = jax.jit(env.finish_step)(state, world.scene, _unmoved(physics, dropped=3), jp.zeros(12))
    assert after.metrics["contacts/dropped"] == 3.0 and set(after.metrics) == set(state.metrics)
    assert after.metrics["at_goal"] == 0.0


def test_within_a_metre_of_the_goal_is_a_metric():
    env = make_env("hill", config=EnvConfig(observation=BLIND))
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    scene, finish = state.pipeline_state.scene, jax.jit(env.finish_step)
    assert state.metrics["at_goal"] == 0.0
    for offset, there in (((0.6, 0.0, 0.79), 1.0), ((0.0, -0.6, 0.81), 0.0)):  # 0.992 m, 1.008 m
        physics = _edit(state, qpos=jp.zeros(19).at[:3].set(scene.goal + jp.array(offset)).at[3].set(1.0))
        after = finish(state, scene, _unmoved(physics.pipeline_state.physics), jp.zeros(12))
        assert after.metrics["at_goal"] == there
