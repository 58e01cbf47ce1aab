"""A policy that holds its view: what it saw can be told afterwards, so its log-probabilities can be recomputed."""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PPOConfig
from loco_mjx.env import autoreset
from loco_mjx.networks.outputs import DEPTH
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import distribution
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.actor import held_since, policy_input
from loco_mjx.ppo.rollout import collect
from loco_mjx.ppo.update import experience
from tests.ppo.probes import SignProbe
from tests.ppo.test_rollout import ENVS, STEPS, Linear

HOLD = 4


@pytest.fixture(scope="module")
def held():
    """A window of a probe whose episodes are 5 steps long, collected by a policy that holds its view for 4."""
    env = SignProbe(horizon=5, depth=True, size=8, action_size=2, start_spread=3)
    networks = Networks(Linear(), uses_state=True, uses_depth=True, hold=HOLD)
    statistics = normalizer_lib.create(2)

    def run(key):
        pool = env.make_pool(key, 16)
        keys = jax.random.split(key, ENVS)
        start = jax.vmap(lambda k: autoreset.first(env, k, pool))(keys)
        params = networks.init(key, policy_input(start.obs, statistics))
        middle, _, _ = collect(env, networks, params, statistics, start, pool, keys, HOLD)  # episodes are under way
        return params, collect(env, networks, params, statistics, middle, pool, keys + 1, STEPS)[1]

    params, rollout = jax.jit(run)(jax.random.PRNGKey(9))
    return networks, statistics, params, rollout


def _recomputed(held, period):
    networks, *window = held

    @jax.jit
    def recompute(statistics, params, rollout):
        observation = experience(rollout, statistics, PPOConfig(), period).observation(jp.arange(STEPS * ENVS))
        outputs = networks.apply(params, observation)
        log_prob = distribution.log_prob(rollout.action.reshape(-1, 2), outputs.mean, outputs.log_std)
        return log_prob.reshape(STEPS, ENVS), observation[DEPTH].reshape(STEPS, ENVS, 8, 8, 4)

    return jax.tree.map(np.asarray, recompute(*window))


def test_recomputed_log_probabilities_match(held):
    log_prob, _ = _recomputed(held, HOLD)
    np.testing.assert_allclose(log_prob, held[3].log_prob, atol=1e-5)


def test_they_would_not_match_if_every_frame_had_been_seen(held):
    log_prob, _ = _recomputed(held, 1)
    assert np.abs(log_prob - np.array(held[3].log_prob)).max() > 1e-2


def test_the_view_changes_on_the_windows_clock_and_at_an_episodes_start(held):
    _, seen = _recomputed(held, HOLD)
    fresh = np.array(held[3].reset)[:-1] > 0  # observation t + 1 starts an episode
    clock = np.arange(1, STEPS) % HOLD == 0
    changed = (np.array(seen[1:]) != np.array(seen[:-1])).any((2, 3, 4))
    assert not changed[~(fresh | clock[:, None])].any()
    assert changed[clock].any() and changed[fresh].any()


def test_the_step_whose_depth_is_held_by_hand():
    step, start = jp.array([0, 3, 5, 7, 7, 10]), jp.array([-3, -3, -3, 6, 2, 10])
    np.testing.assert_array_equal(held_since(step, start, 4), [0, 0, 4, 6, 4, 10])
