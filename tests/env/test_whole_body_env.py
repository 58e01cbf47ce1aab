"""Controller `mpc` in the environment: what an action commands, what is observed, paid for, and forgotten."""

import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx import rotations
from loco_mjx.config import DepthConfig, preset
from loco_mjx.deploy import folder
from loco_mjx.deploy.description import describe
from loco_mjx.env import LocoEnv, action, autoreset
from loco_mjx.env.drive import substeps
from loco_mjx.run import orbax_trees
from loco_mjx.scene import mjcf
from loco_mjx.simcheck.follow import make_follower
from loco_mjx.simcheck.sides import WatchedRobot
from tests.known_robots import A1
from tests.light import LIGHT
from tests.refusals import refusal

HORIZON = 30
ACTIONS = jp.array([[1.0, 0.0], [0.5, 1.0], [-1.0, 0.0], [5.0, 0.0]])  # the last beyond the limits
RATES = np.array([0.4, 0.3])


@pytest.fixture(scope="session")
def env():
    config = preset("fast", controller="mpc").env
    blind = dataclasses.replace(config.observation, depth=DepthConfig(enabled=False))
    return LocoEnv(dataclasses.replace(config, observation=blind, horizon=HORIZON, physics=LIGHT))


@pytest.fixture(scope="session")
def walked(env):
    """States of 4 environments, first to last: an episode under ACTIONS, and the first two steps of the next."""
    pool = env.make_pool(jax.random.PRNGKey(5), 4)
    first = jax.jit(jax.vmap(lambda key: autoreset.first(env, key, pool)))
    step = jax.jit(jax.vmap(lambda state, a: autoreset.step(env, state, a, pool)))
    states = [first(jax.random.split(jax.random.PRNGKey(1), 4))]
    for _ in range(HORIZON + 2):
        states.append(step(states[-1], ACTIONS))
    return jax.device_get(states)


def test_it_walks_as_it_is_commanded(env, walked):
    assert env.action_size == 2 and env.dt == pytest.approx(0.05)
    first, last = (walked[i].pipeline_state.physics.qpos for i in (10, HORIZON))
    seconds = (HORIZON - 10) * env.dt
    assert last[[0, 2], 0] - first[[0, 2], 0] == pytest.approx([0.4 * seconds, -0.4 * seconds], abs=0.08)
    yaw = rotations.yaw(last[1, 3:7], np) - rotations.yaw(first[1, 3:7], np)
    assert yaw == pytest.approx(0.3 * seconds, abs=0.08)
    np.testing.assert_array_equal(walked[3].pipeline_state.episode.last_action[3], np.float32([0.4, 0.0]))


def test_it_observes_its_mean_velocity_and_its_attitude(env, walked):
    assert env.observation_size == {"state": (6,)}
    before, after = (state.pipeline_state.physics.qpos for state in walked[20:22])
    state = walked[21].obs["state"]
    np.testing.assert_allclose(state[:, :3], (after - before)[:, :3] / env.dt, atol=1e-5)
    np.testing.assert_allclose(state[:, 3:5], [rotations.roll_pitch(quat, np) for quat in after[:, 3:7]], atol=1e-5)
    np.testing.assert_allclose(state[:, 5], [rotations.yaw(quat, np) for quat in after[:, 3:7]], atol=1e-5)


def test_it_is_paid_for_its_way_and_for_staying_up(walked):
    before, after = walked[20:22]
    ahead = (after.pipeline_state.physics.qpos - before.pipeline_state.physics.qpos)[:, 0] / 0.05
    np.testing.assert_allclose(after.reward, 0.5 * ahead + 0.1, atol=1e-5)
    assert not after.metrics["reward/energy"].any()


def test_programs_that_are_not_solved_are_counted(walked):
    assert all((state.metrics["unsolved"] == 0).all() for state in walked)
    assert "unsolved" in walked[-1].info["episode"]


def test_what_the_controller_remembers_ends_with_the_episode(walked):
    ticks = [state.pipeline_state.control.memory.state.tick for state in walked]
    assert (ticks[HORIZON] == 10 * HORIZON).all() and walked[HORIZON].done.all()
    assert (ticks[HORIZON + 1] == 0).all() and (ticks[HORIZON + 2] == 10).all()


def test_what_the_controller_remembers_is_in_a_checkpoint(walked, tmp_path):
    state = jax.tree.map(jp.asarray, walked[5])
    orbax_trees.write_trees(tmp_path, {"training": state})
    found = orbax_trees.read_tree(tmp_path / "training", jax.tree.map(jp.zeros_like, state))
    jax.tree.map(np.testing.assert_array_equal, found, state)


def test_an_action_and_its_command(env):
    drawn = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    np.testing.assert_allclose(action.scale(env.config), RATES)
    np.testing.assert_allclose(action.from_offsets(RATES * action.numbers(drawn, env.config), env.config), drawn)
    assert action.neutral(env.config).tolist() == [0.0, 0.0]


def test_a_robot_without_whole_steps_in_a_tick_is_refused():
    with refusal("a1 0.003 mpc 0.005"):
        substeps(dataclasses.replace(A1, physics_dt=0.003))


def follower_on(env, state, i):
    """C MuJoCo's robot in a state of ours, and who carries out decisions on it."""
    pytest.importorskip("quadprog")  # the extra `mpc`
    world = jax.tree.map(lambda x: np.asarray(x[i]), state.pipeline_state)
    config = dataclasses.replace(preset("fast", controller="mpc"), policy="state-only", env=env.config)
    training = {"training": {"task": "thin", "samples": 0, "evaluation": None}}
    manifest = folder.build(describe(config, ("state",), 1) | training)
    robot = WatchedRobot(mjcf.scene_spec(world.scene, A1).compile(), None, lying=False, policy_hz=manifest.policy_hz)
    robot.put(world.physics.qpos, world.physics.qvel, world.scene.spheres.collected)
    follower = make_follower(manifest, A1)
    return robot, follower, world


@pytest.mark.parametrize("start", [0, 10])
def test_c_mujoco_walks_as_far_and_observes_the_same(env, walked, start):
    """From the episode's start, and from its middle with what the controller remembers by then."""
    robot, follower, world = follower_on(env, walked[start], 1)
    if start:
        follower.resume(world.control, robot)
    for _ in range(10):
        follower.follow(robot, np.array([0.2, 0.3]))
        seen = follower.observe(robot, np.zeros(2))["state"]
    ours = walked[start + 10]
    np.testing.assert_allclose(robot.data.qpos[:3], ours.pipeline_state.physics.qpos[1, :3], atol=0.02)
    np.testing.assert_allclose(seen[:3], ours.obs["state"][1, :3], atol=0.1)
    np.testing.assert_allclose(seen[3:], ours.obs["state"][1, 3:], atol=0.05)
    assert follower.facts() == {"unsolved": 0.0}
