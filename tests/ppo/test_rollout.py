"""What a rollout holds, and that reading it back gives what the policy saw."""

from __future__ import annotations

import dataclasses

import flax.linen as nn
import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PPOConfig
from loco_mjx.env import autoreset
from loco_mjx.networks.outputs import DEPTH, STATE, Outputs
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import distribution, frame_stack
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.actor import policy_input
from loco_mjx.ppo.rollout import averages, collect
from loco_mjx.ppo.update import experience
from tests.ppo.probes import BrokenProbe, SignProbe

ENVS, STEPS = 4, 12


class Linear(nn.Module):
    """A policy for small images."""

    @nn.compact
    def __call__(self, obs):
        features = jp.concatenate([obs[STATE], obs[DEPTH].reshape(*obs[STATE].shape[:-1], -1)], -1)
        mean = nn.Dense(2)(features)
        return Outputs(mean, jp.full_like(mean, -0.3), nn.Dense(1)(features)[..., 0])


@pytest.fixture(scope="module")
def rollout():
    """Two windows of a probe with 8×8 images and episodes of 5 steps, and the observations replayed one by one."""
    env = SignProbe(horizon=5, truncates=True, depth=True, size=8, action_size=2, start_spread=3)
    networks = Networks(Linear(), uses_state=True, uses_depth=True)
    key = jax.random.PRNGKey(5)
    pool = env.make_pool(key, 16)
    statistics = normalizer_lib.update(normalizer_lib.create(2), jax.random.normal(key, (9, 2)), jp.ones(9))

    def run():
        keys = jax.random.split(key, ENVS)
        start = jax.vmap(lambda k: autoreset.first(env, k, pool))(keys)
        params = networks.init(key, policy_input(start.obs, statistics))
        middle, first, _ = collect(env, networks, params, statistics, start, pool, keys, 7)
        _, second, sums = collect(
            env, networks, params, statistics, middle, pool, jax.random.split(key + 1, ENVS), STEPS
        )

        def replay(state, action):
            after = jax.vmap(lambda s, a: autoreset.step(env, s, a, pool))(state, jp.tanh(action))
            return after, (state, after)

        _, (before, after) = jax.lax.scan(replay, middle, second.action)
        return params, first, second, sums, before, after

    return networks, statistics, *jax.jit(run)()


def test_rows_equal_a_replay(rollout):
    _, _, _, _, data, _, before, after = rollout
    np.testing.assert_array_equal(data.state[:-1], before.obs[STATE])
    np.testing.assert_array_equal(data.reward, after.reward)
    np.testing.assert_array_equal(data.done, after.done)
    np.testing.assert_array_equal(data.reset, before.done)  # the transition that spans the reset starts at a done state
    np.testing.assert_array_equal(data.terminated, 0 * data.done)  # this probe only truncates
    assert 8 <= float(data.done.sum()) <= 16  # 4 environments, 12 rows, 3 to 6 rows to an episode and its reset
    assert len(set(np.argmax(data.done, axis=0).tolist())) > 1  # they do not end together


def test_stacks_equal_what_the_environment_showed(rollout):
    _, statistics, _, _, data, _, before, _ = rollout
    read = jax.jit(lambda: experience(data, statistics, PPOConfig()).observation(jp.arange(STEPS * ENVS)))()
    shown = before.obs[DEPTH].reshape(STEPS * ENVS, 8, 8, 4)
    np.testing.assert_array_equal(read[DEPTH], frame_stack.rounded(shown))
    np.testing.assert_allclose(read[DEPTH], shown, atol=1e-3)
    np.testing.assert_allclose(
        read[STATE], normalizer_lib.normalize(statistics, before.obs[STATE]).reshape(-1, 2), atol=1e-6
    )
    # The frames tell steps apart, so a shift by one would have shown.
    assert float(jp.abs(shown[..., 0] - shown[..., 1]).max(axis=(1, 2)).min(initial=9, where=_running(before))) > 0.05


def _running(before):
    """(T·B,) rows that are not the first of an episode."""
    return np.asarray(before.info["first"]).reshape(-1) == 0


def test_each_frame_is_stored_once(rollout):
    _, _, _, first, data, _, _, _ = rollout
    assert data.frames.shape == (4 + STEPS, ENVS, 8, 8) and data.frames.dtype == jp.float16
    # A window starts with the frames that the one before it ended with.
    np.testing.assert_array_equal(data.frames[3], first.frames[-1])


def test_log_probs_and_values_are_those_of_the_stored_inputs(rollout):
    networks, statistics, params, _, data, _, _, _ = rollout
    rows = jp.arange(STEPS * ENVS)
    obs = experience(data, statistics, PPOConfig()).observation(rows)
    outputs = networks.apply(params, obs)
    action = data.action.reshape(-1, 2)
    expected = distribution.log_prob(action, outputs.mean, outputs.log_std)
    np.testing.assert_allclose(data.log_prob.reshape(-1), expected, atol=1e-4)
    np.testing.assert_allclose(data.value[:-1].reshape(-1), outputs.value, atol=1e-4)
    assert data.value.shape == (STEPS + 1, ENVS)
    assert float(jp.abs(data.action).max()) > 1.0  # before the tanh


def test_metrics_average_ended_episodes_and_taken_steps(rollout):
    _, _, _, _, data, sums, before, after = rollout
    got = averages(sums)
    taken, ended = np.asarray(before.done) == 0, np.asarray(after.done) == 1
    assert float(got["episodes"]) == ended.sum()
    assert float(got["nonfinite"]) == 0
    np.testing.assert_allclose(got["step/reward"], np.asarray(data.reward)[taken].mean(), rtol=1e-5)
    np.testing.assert_allclose(got["step/seen"], np.asarray(after.metrics["seen"])[taken].mean(), atol=1e-6)
    for name in ("return", "length", "seen"):
        expected = np.asarray(after.info["episode"][name])[ended].mean()
        np.testing.assert_allclose(got[f"episode/{name}"], expected, rtol=1e-5, atol=1e-6)
    assert float(averages(jax.tree.map(jp.zeros_like, sums))["episode/return"]) == 0.0


def test_what_is_not_finite_is_counted_and_kept_out():
    env = BrokenProbe(horizon=30, depth=True, size=8, action_size=2)
    networks = Networks(Linear(), uses_state=True, uses_depth=True)
    key = jax.random.PRNGKey(5)
    pool = env.make_pool(key, 4)

    @jax.jit
    def run():
        keys = jax.random.split(key, ENVS)
        start = jax.vmap(lambda k: autoreset.first(env, k, pool))(keys)
        statistics = normalizer_lib.create(2)
        params = networks.init(key, policy_input(start.obs, statistics))
        return collect(env, networks, params, statistics, start, pool, keys, 6)[1:]

    data, sums = run()
    assert all(bool(jp.isfinite(x).all()) for x in jax.tree.leaves(data))
    assert float(averages(sums)["nonfinite"]) == 4 * ENVS  # observations 2 and 5, rewards of steps 2 and 5
    np.testing.assert_array_equal(data.reward[2], 0)
    assert float(jp.abs(data.reward[1]).min()) > 0


def test_frames_wait_for_the_policy_that_reads_them(rollout):
    networks, statistics, params, *_ = rollout
    blind = dataclasses.replace(networks, uses_depth=False)
    env = SignProbe(depth=True, size=8, action_size=2)
    pool = env.make_pool(jax.random.PRNGKey(0), 4)

    def run(key):
        start = jax.vmap(lambda k: autoreset.first(env, k, pool))(jax.random.split(key, 2))
        return collect(env, blind, params, statistics, start, pool, jax.random.split(key, 2), 3)[1]

    assert jax.eval_shape(run, jax.random.PRNGKey(0)).frames is None
