"""The training program: reproducible, compiled once, the same on one device and two."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.actor import Actor
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.sharding import make_mesh
from tests.ppo.probes import BrokenProbe, Probe, tiny
from tests.refusals import refusal

ITERATIONS, STD = 40, 0.2


def _mesh(devices):
    return make_mesh(jax.devices()[:devices])


def _whole_batch(devices):
    """A trainer whose one minibatch is the whole rollout, so that shuffling does not matter.

    The probe yields what is not finite: all that is promised below holds nevertheless.
    """
    config = tiny(minibatch=128, epochs=4, pool_refresh=2, total_steps=128 * ITERATIONS, final_std=STD, average=0.5)
    return Trainer(config, BrokenProbe(horizon=6, start_spread=4), _mesh(devices))


@pytest.fixture(scope="module")
def one():
    return _whole_batch(1)


@pytest.fixture(scope="module")
def two():
    return _whole_batch(2)


def _train(trainer, iterations):
    state, history = trainer.init(), []
    for i in range(iterations):
        state, metrics = trainer.iterate(state, trainer.make_pool(i))
        history.append(jax.device_get(metrics))
    return jax.device_get(state), history


def _assert_equal(x, y):
    jax.tree.map(np.testing.assert_array_equal, x, y)


def test_same_seed_same_bits_and_one_compilation(two):
    first, second = _train(two, 3), _train(two, 3)
    _assert_equal(first, second)
    assert two.iterate._cache_size() == 1
    assert two.draw_pool._cache_size() == 1
    state, history = first
    assert int(state.iteration) == 3 and int(state.samples) == 3 * 128
    assert not np.array_equal(history[0]["loss/total"], history[1]["loss/total"])


def test_state_is_arrays_of_fixed_types(two):
    state = two.init()
    leaves = jax.tree.leaves(state)
    assert all(isinstance(x, jax.Array) and not x.weak_type for x in leaves)
    shapes = jax.tree.map(lambda x: (x.shape, x.dtype), state)
    assert shapes == jax.tree.map(lambda x: (x.shape, x.dtype), two.iterate(state, two.make_pool(0))[0])


def test_collect_then_update_is_iterate(two):
    pool = two.make_pool(0)
    state, rollout, collected = two.collect(two.init(), pool)
    state, learnt = two.update(state, rollout)
    iterated, metrics = two.iterate(two.init(), pool)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-6), state.params, iterated.params)
    assert set(metrics) == set(collected) | set(learnt)
    assert all(x.shape == () for x in metrics.values())


def test_two_devices_do_what_one_does(one, two):
    """Environments' keys do not depend on the devices, and sums over them make the minibatch whole."""
    (state_one, history_one), (state_two, history_two) = _train(one, 3), _train(two, 3)
    for metrics_one, metrics_two in zip(history_one, history_two, strict=True):
        for name, value in metrics_one.items():
            np.testing.assert_allclose(metrics_two[name], value, rtol=2e-2, atol=2e-3, err_msg=name)
    np.testing.assert_array_equal(state_one.env_state.done, state_two.env_state.done)
    np.testing.assert_array_equal(state_one.env_state.obs["state"], state_two.env_state.obs["state"])
    np.testing.assert_allclose(state_one.normalizer.mean, state_two.normalizer.mean, atol=1e-5)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=5e-3), state_one.params, state_two.params)


def test_the_policy_is_the_mean_of_what_each_iteration_left(two):
    state, left = two.init(), []
    _assert_equal(state.policy, state.params)
    for i in range(4):
        state, _ = two.iterate(state, two.make_pool(i))
        left.append(jax.device_get(state.params))
    mean = jax.tree.map(lambda a, b, c, d: ((a + b) / 2 + c) / 4 + d / 2, *left)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-7), state.policy, mean)
    assert dataclasses.replace(state, mean=None).policy is state.params


def test_environments_differ(two):
    signs = np.asarray(two.init().env_state.pipeline_state["sign"])
    assert signs.shape == (16,) and len(set(signs.tolist())) == 2
    _, rollout, _ = two.collect(two.init(), two.make_pool(0))
    actions = np.asarray(rollout.action)
    assert len(np.unique(actions)) == actions.size


def test_pools_follow_the_seed_and_the_iteration(one, two):
    _assert_equal(one.make_pool(1), one.make_pool(0))  # pool_refresh is 2
    _assert_equal(one.make_pool(3), two.make_pool(2))
    assert not np.array_equal(one.make_pool(2), one.make_pool(0))


def test_normaliser_takes_in_what_was_collected_after_the_update(two):
    pool, start = two.make_pool(0), two.init()
    _, rollout, _ = two.collect(start, pool)
    state, _ = two.iterate(start, pool)
    expected = normalizer_lib.update(normalizer_lib.create(2), rollout.state[:-1], rollout.weight)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-5), state.normalizer, expected)
    assert float(state.normalizer.count) == 128 - float(rollout.reset.sum()) < 128


def test_learns_and_nothing_that_is_not_finite_reaches_the_parameters(two):
    state, history = _train(two, ITERATIONS)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves((state.params, state.opt_state, state.normalizer)))
    assert all(np.isfinite(x) for metrics in history for x in metrics.values())
    assert all(metrics["nonfinite"] > 10 and metrics["skipped_updates"] == 0 for metrics in history)
    # Two of three rewards can be earned, by acting as the sign says.
    assert abs(history[0]["step/reward"]) < 0.2 and history[-1]["step/reward"] > 0.4
    actor = Actor(two.networks, state.params, state.normalizer)
    obs = {"state": jp.array([[1.0, 0.5], [-1.0, 0.5]])}
    actions, _ = jax.jit(actor.act)(obs)
    assert float(actions[0, 0]) > 0.7 and float(actions[1, 0]) < -0.7
    assert np.exp(state.params["params"]["policy_head"]["log_std"]) <= STD + 1e-6 < history[0]["policy/std"]


def test_stochastic_inference_draws_from_the_gaussian(two):
    state = two.init()  # mean near 0, standard deviation 1
    actor = Actor(two.networks, state.params, state.normalizer, deterministic=False)
    obs = {"state": jp.array([[1.0, 0.5], [-1.0, 0.5]])}
    keys = jax.random.split(jax.random.PRNGKey(0), 4000)
    drawn = np.asarray(jax.jit(jax.vmap(lambda key: actor.act(obs, key=key)[0]))(keys))
    assert drawn.shape == (4000, 2, 1) and np.abs(drawn).max() <= 1.0
    np.testing.assert_allclose(np.arctanh(drawn).std(0), 1.0, rtol=0.05)
    np.testing.assert_allclose(np.arctanh(drawn).mean(0), 0.0, atol=0.1)


def test_sizes_and_senses_must_fit():
    with refusal("loco-transformer depth"):
        Trainer(tiny("loco-transformer"), Probe())
    with refusal("ppo.num_envs 15 2"):
        Trainer(tiny(num_envs=15, minibatch=30), Probe(), _mesh(2))
