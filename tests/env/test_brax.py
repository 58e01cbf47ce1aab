"""Our environment in Brax's own wrappers, evaluator and learner, and the wrapper that is made for them."""

from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest
from brax import envs
from brax.training import acting
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.agents.ppo import networks_vision
from brax.training.agents.ppo import train as ppo

from loco_mjx import make_env, wrap_for_brax
from loco_mjx.config import DepthConfig, EnvConfig, ObservationConfig
from loco_mjx.env.state import State
from tests.known_robots import A1
from tests.light import LIGHT
from tests.ppo.probes import Probe
from tests.refusals import refusal

N, LENGTH, POOL = 2, 3, 4  # environments, control steps of an episode, scenes
BLIND = EnvConfig(observation=ObservationConfig(depth=DepthConfig(enabled=False)), physics=LIGHT)
SEEING = EnvConfig(observation=ObservationConfig(depth=DepthConfig(height=8, width=8)), physics=LIGHT)
PUSH = jp.tile(jp.linspace(-1.0, 1.0, 12), (N, 1))
LYING = jp.array([0.5, 0.866, 0.0, 0.0])  # quaternion of a robot on its side


@pytest.fixture(scope="session")
def blind():
    return make_env("thin", config=BLIND)


@pytest.fixture(scope="session")
def wrapped(blind):
    """(first state of N environments, jitted step)."""
    env = wrap_for_brax(blind, episode_length=LENGTH, pool_size=POOL)
    return jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(1), N)), jax.jit(env.step)


class Recorded(envs.Wrapper):
    """Keeps what learners take from every step: (steps, truncation, done, observed state, progress)."""

    def __init__(self, env):
        super().__init__(env)
        self.log = []

    def step(self, state, action):
        after = self.env.step(state, action)
        seen = (
            after.info["steps"],
            after.info["truncation"],
            after.done,
            after.obs["state"],
            after.metrics["progress"],
        )
        jax.debug.callback(lambda *row: self.log.append([np.array(part) for part in row]), *seen, ordered=True)
        return after


def _run(first, step, count, action=PUSH):
    states = [first]
    for _ in range(count):
        states.append(step(states[-1], action))
    return states


def _info(states, name):
    return np.array([state.info[name] for state in states[1:]])


def _begun(state):
    """Checks that of three frames of an observed state (N, 93) one is new and two are the standing robot's."""
    for first, size, standing in ((0, 3, 0.0), (9, 4, 0.0), (21, 12, 0.0), (57, 12, np.array(A1.default_pose))):
        assert (np.abs(state[:, first : first + size] - standing).max(axis=1) > 0).all()
        past = np.array(state[:, first + size : first + 3 * size]).reshape(N, 2, size)
        np.testing.assert_allclose(past, np.broadcast_to(standing, past.shape), atol=1e-6)


def _lay(state, i):
    world = state.pipeline_state
    qpos = world.physics.qpos.at[i, 3:7].set(LYING)
    return state.replace(pipeline_state=world.replace(physics=world.physics.replace(qpos=qpos)))


def test_the_state_has_the_fields_of_braxs():
    assert list(State.__dataclass_fields__) == list(envs.State.__dataclass_fields__)


def test_braxs_own_wrappers_and_evaluator_count_sum_and_reset(blind):
    env = Recorded(envs.training.wrap(blind, episode_length=LENGTH))
    policy = lambda _: lambda obs, key: (PUSH, {})  # noqa: E731
    evaluator = acting.Evaluator(env, policy, N, 2 * LENGTH, 1, jax.random.PRNGKey(1))
    metrics = evaluator.run_evaluation(None, {})
    jax.effects_barrier()
    steps, truncation, done, state, progress = (np.array(part) for part in zip(*env.log, strict=True))
    np.testing.assert_array_equal(steps.T, N * [[1, 2, 3, 1, 2, 3]])
    np.testing.assert_array_equal(truncation.T, N * [[0, 0, 1, 0, 0, 1]])
    np.testing.assert_array_equal(done.T, N * [[0, 0, 1, 0, 0, 1]])
    np.testing.assert_array_equal(state[LENGTH:], state[:LENGTH])  # the first episode's: nothing of it was left
    _begun(state[LENGTH])
    assert metrics["eval/avg_episode_length"] == LENGTH
    assert metrics["eval/episode_progress"] == pytest.approx(progress[:LENGTH].sum(0).mean(), rel=1e-4)


def test_an_episode_lasts_as_long_as_was_asked_for_and_ends_in_a_truncation(wrapped):
    states = _run(*wrapped, 2 * LENGTH)
    ends = N * [[0, 0, 1, 0, 0, 1]]
    np.testing.assert_array_equal(_info(states, "steps").T, N * [[1, 2, 3, 1, 2, 3]])
    for values in (_info(states, "truncation"), _info(states, "episode_done"), np.array([s.done for s in states[1:]])):
        np.testing.assert_array_equal(values.T, ends)
    for end in (LENGTH, 2 * LENGTH):
        sums = states[end].info["episode_metrics"]
        episode = states[end - LENGTH + 1 : end + 1]
        np.testing.assert_allclose(sums["sum_reward"], sum(np.array(s.reward) for s in episode), rtol=1e-5)
        np.testing.assert_allclose(sums["progress"], sum(np.array(s.metrics["progress"]) for s in episode), rtol=1e-5)
        np.testing.assert_array_equal(sums["length"], LENGTH)


def test_a_new_episode_begins_afresh_in_a_scene_of_the_pool(wrapped):
    first, step = wrapped
    pool = np.array(first.info["scenes"].boxes.center).reshape(POOL, -1, 3)
    states = _run(first, step, 12 * LENGTH)
    seen = set()
    for state in states[::LENGTH]:
        np.testing.assert_array_equal(state.obs["state"], first.obs["state"])  # the standing robot's history
        np.testing.assert_array_equal(state.pipeline_state.episode.step, 0)
        for centres in np.array(state.pipeline_state.scene.boxes.center):
            matches = np.flatnonzero((pool == centres).all(axis=(1, 2)))
            assert len(matches) == 1
            seen.add(int(matches[0]))
    assert seen == set(range(POOL))
    places = np.array([state.pipeline_state.physics.qpos[:, :2] for state in states[::LENGTH]])
    assert len(np.unique(places.reshape(-1, 2), axis=0)) == 13 * N  # and starts somewhere else
    _begun(states[LENGTH + 1].obs["state"])


def test_a_fall_is_no_truncation_at_the_time_limit_either_and_resets_nobody_else(wrapped):
    first, step = wrapped
    states = _run(first, step, LENGTH - 1)
    for before, done, truncation in ((first, [1, 0], [0, 0]), (states[-1], [1, 1], [0, 1])):
        after, beside = step(_lay(before, 0), PUSH), step(before, PUSH)
        np.testing.assert_array_equal(after.done, done)
        np.testing.assert_array_equal(after.info["truncation"], truncation)
        for one, other in zip(jax.tree.leaves(after), jax.tree.leaves(beside), strict=True):
            np.testing.assert_array_equal(one[1], other[1])
    np.testing.assert_array_equal(step(after, PUSH).info["steps"], 1)


@pytest.mark.parametrize("truncates", [True, False])
def test_how_the_environment_ends_an_episode_holds_at_the_same_time_limit_too(truncates):
    env = wrap_for_brax(Probe(horizon=2, truncates=truncates), episode_length=2)
    first = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(1), N))
    states = _run(first, jax.jit(env.step), 4, jp.zeros((N, 1)))
    np.testing.assert_array_equal(_info(states, "episode_done").T, N * [[0, 1, 0, 1]])
    np.testing.assert_array_equal(_info(states, "truncation").T, N * [[0, truncates, 0, truncates]])


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"action_repeat": 2}, "action_repeat 2 1"),
        ({"randomization_fn": len}, "randomization_fn None"),
        ({"episode_length": 0}, "episode_length 0 1"),
        ({"pool_size": 0}, "pool_size 0 1"),
    ],
)
def test_what_it_cannot_do_is_refused(asked, named):
    with refusal(named):
        wrap_for_brax(Probe(), **asked)


@pytest.fixture(scope="session")
def device_put_replicated():
    """What Brax 0.14 calls and JAX no longer has."""
    patch = pytest.MonkeyPatch()
    if not hasattr(jax, "device_put_replicated"):
        replicate = lambda tree, devices: jax.pmap(lambda _: tree, devices=devices)(jp.arange(len(devices)))  # noqa: E731
        patch.setattr(jax, "device_put_replicated", replicate, raising=False)
    yield
    patch.undo()


@pytest.fixture(scope="session")
def train(device_put_replicated):
    """Two iterations of Brax's PPO, its networks tiny: (parameters before and after, what it returns)."""

    def run(env, network):
        saved = []
        returned = ppo.train(
            env,
            num_timesteps=32,
            num_envs=4,
            episode_length=LENGTH,
            wrap_env_fn=partial(wrap_for_brax, pool_size=POOL),
            unroll_length=4,
            batch_size=2,
            num_minibatches=2,
            num_updates_per_batch=1,
            num_eval_envs=N,
            normalize_observations=True,
            network_factory=partial(network, policy_hidden_layer_sizes=(8,), value_hidden_layer_sizes=(8,)),
            policy_params_fn=lambda step, act, params: saved.append((step, params)),
            run_evals=False,
        )
        return saved, returned

    return run


def _learnt(saved, metrics):
    (_, before), (samples, after) = saved
    assert samples == 32
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))
    changed = jax.tree.map(lambda a, b: bool((a != b).any()), before[1:], after[1:])  # policy and value
    assert np.mean(jax.tree.leaves(changed)) > 0.8  # all but, at times, a bias
    assert np.isfinite(metrics["training/total_loss"])


def test_braxs_ppo_trains_a_blind_policy(blind, train):
    network = partial(ppo_networks.make_ppo_networks, policy_obs_key="state", value_obs_key="state")
    saved, (make_policy, params, metrics) = train(blind, network)
    _learnt(saved, metrics)
    action, _ = make_policy(params)({"state": jp.zeros((N, 93))}, jax.random.PRNGKey(0))
    assert action.shape == (N, 12)


def test_braxs_ppo_trains_a_policy_that_sees(train):
    network = partial(
        networks_vision.make_ppo_networks_vision,
        cnn_output_channels=(4,),
        cnn_kernel_size=(4,),
        cnn_stride=(4,),
        policy_obs_key="state",
        value_obs_key="state",
    )
    saved, (make_policy, params, metrics) = train(make_env("thin", config=SEEING), network)
    _learnt(saved, metrics)
    obs = {"state": jp.zeros((N, 93)), "pixels/depth": jp.zeros((N, 8, 8, 4))}
    action, _ = make_policy(params)(obs, jax.random.PRNGKey(0))
    assert action.shape == (N, 12)
