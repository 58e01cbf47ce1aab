"""Epochs, minibatches and optimiser steps on synthetic experience."""

from __future__ import annotations

import dataclasses
from functools import partial

import flax.linen as nn
import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PPOConfig
from loco_mjx.networks.outputs import STATE, Outputs
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo import update as lib
from loco_mjx.ppo.rollout import Rollout

STEPS, ENVS = 6, 4
CONFIG = PPOConfig(num_envs=ENVS, unroll=STEPS, minibatch=12, epochs=3, max_grad_norm=0.5)


class _Linear(nn.Module):
    @nn.compact
    def __call__(self, obs):
        mean = nn.Dense(2)(obs[STATE])
        log_std = jp.broadcast_to(self.param("log_std", nn.initializers.zeros_init(), (2,)), mean.shape)
        return Outputs(mean, log_std, nn.Dense(1)(obs[STATE])[..., 0])


NETWORKS = Networks(_Linear(), uses_state=True, uses_depth=False)


def _rollout():
    draw = np.random.default_rng(0)

    def normal(*shape):
        return jp.array(draw.normal(size=shape), jp.float32)

    done = np.zeros((STEPS, ENVS), np.float32)
    done[1, 0] = done[3, 2] = done[4, 2 + 1] = 1
    reset = np.concatenate([np.zeros((1, ENVS), np.float32), done[:-1]])
    terminated = done * np.array([1, 1, 1, 0], np.float32)
    return Rollout(
        state=normal(STEPS + 1, ENVS, 3),
        frames=None,
        action=normal(STEPS, ENVS, 2),
        log_prob=normal(STEPS, ENVS) - 3.0,
        value=normal(STEPS + 1, ENVS),
        reward=normal(STEPS, ENVS),
        terminated=jp.array(terminated),
        done=jp.array(done),
        reset=jp.array(reset),
    )


@pytest.fixture(scope="module")
def learned():
    params = jax.jit(NETWORKS.init)(jax.random.PRNGKey(1), {STATE: jp.zeros((1, 3))})
    return jax.jit(lambda: (params, lib.make_optimizer(CONFIG).init(params)))()


def _data(rollout):
    return lib.experience(rollout, normalizer_lib.create(3), CONFIG)


@partial(jax.jit, static_argnames=("chunk", "config"))
def _update(learned, rollout, key, rate=1e-2, chunk=None, config=CONFIG):
    return lib.update(NETWORKS, config, learned, _data(rollout), key, jp.asarray(rate, jp.float32), None, chunk)


_apply_gradients = jax.jit(partial(lib.apply_gradients, CONFIG))


def _assert_close(got, expected, **tolerance):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, **tolerance), got, expected)


def test_every_epoch_reads_every_sample_once_in_another_order(key):
    rows = np.asarray(lib.minibatches(key, 24, CONFIG)).reshape(3, 2, 12)
    for epoch in rows:
        assert sorted(epoch.ravel().tolist()) == list(range(24))
    assert not np.array_equal(rows[0], rows[1])


def test_reset_rows_have_no_influence(learned, key):
    rollout = _rollout()
    masked = np.asarray(rollout.reset) == 1
    assert masked.sum() == 3

    def changed(x, rows):
        return jp.where(rows.reshape(*rows.shape, *[1] * (x.ndim - 2)), -5.0, x)

    # The action and reward of the reset row; its observation is the row before's last, and bootstraps truncations.
    other = dataclasses.replace(
        rollout,
        action=changed(rollout.action, masked),
        reward=changed(rollout.reward, masked),
        log_prob=changed(rollout.log_prob, masked),
        state=changed(rollout.state, np.concatenate([masked, np.zeros((1, ENVS), bool)])),
    )
    got, expected = _update(learned, other, key), _update(learned, rollout, key)
    jax.tree.map(np.testing.assert_array_equal, got, expected)
    # The same change where nothing is masked is felt.
    felt = dataclasses.replace(rollout, reward=changed(rollout.reward, np.roll(masked, 1, axis=1)))
    moved = jax.tree.map(lambda x, y: float(jp.abs(x - y).max()), _update(learned, felt, key)[0][0], expected[0][0])
    assert max(jax.tree.leaves(moved)) > 1e-4


@pytest.mark.parametrize("chunk", [1, 5])
def test_chunks_add_up_to_the_minibatch(learned, key, chunk):
    whole = _update(learned, _rollout(), key)
    parts = _update(learned, _rollout(), key, chunk=chunk)
    _assert_close(parts, whole, rtol=1e-3, atol=1e-5)


def test_chunk_sizes():
    assert lib.chunk_count(128, None) == 1
    assert lib.chunk_count(128, 32) == 4
    assert lib.chunk_count(12, 5) == 3  # of 4
    assert lib.chunk_count(20, 64) == 1
    assert lib.chunk_count(7, 3) == 7


def test_devices_make_the_whole_minibatch(learned, key):
    """With one minibatch of all samples, two devices with half the environments each take one device's step."""
    config = dataclasses.replace(CONFIG, minibatch=STEPS * ENVS, epochs=1)
    rollout = _rollout()
    whole = _update(learned, rollout, key, config=config)
    halves = jax.tree.map(lambda x: jp.stack(jp.split(x, 2, axis=1)), rollout)

    @jax.jit
    @partial(jax.vmap, in_axes=(0, 0), axis_name="env")
    def spread(half, device_key):
        return lib.update(NETWORKS, config, learned, _data(half), device_key, jp.array(1e-2, jp.float32), "env")

    parts = spread(halves, jax.random.split(key))
    for device in range(2):
        _assert_close(jax.tree.map(lambda x, i=device: x[i], parts), whole, rtol=1e-3, atol=1e-5)


def test_gradient_norm_is_clipped(learned):
    params, opt_state = learned
    grads = jax.tree.map(lambda x: jp.full(x.shape, 100.0), params)
    norm = 100.0 * np.sqrt(sum(x.size for x in jax.tree.leaves(params)))
    (_, new_state), metrics = _apply_gradients((params, opt_state), grads, jp.array(1e-2))
    np.testing.assert_allclose(metrics["grad_norm"], norm, rtol=1e-5)
    # Adam's first moment is a tenth of the gradient that reached it.
    first_moment = new_state[1].mu
    seen = np.sqrt(sum(float(jp.sum((10.0 * x) ** 2)) for x in jax.tree.leaves(first_moment)))
    np.testing.assert_allclose(seen, CONFIG.max_grad_norm, rtol=1e-4)


def test_first_step_of_adam_moves_by_the_rate(learned):
    grads = jax.tree.map(lambda x: jp.full(x.shape, -1e-2), learned[0])
    (params, _), _ = _apply_gradients(learned, grads, jp.array(1e-2))
    _assert_close(params, jax.tree.map(lambda x: x + 1e-2, learned[0]), rtol=1e-2, atol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_gradient_that_is_not_finite_changes_nothing(learned, bad):
    grads = jax.tree.map(jp.ones_like, learned[0])
    grads["params"]["log_std"] = grads["params"]["log_std"].at[0].set(bad)
    after, metrics = _apply_gradients(learned, grads, jp.array(1e-2))
    jax.tree.map(np.testing.assert_array_equal, after, learned)
    assert float(metrics["usable"]) == 0.0


def test_skipped_updates_are_counted_and_stay_out_of_the_means(learned, key):
    rollout = _rollout()
    poisoned = dataclasses.replace(rollout, action=rollout.action.at[0, 1].set(jp.nan))
    after, metrics = _update(learned, poisoned, key)
    assert float(metrics["skipped_updates"]) == 3  # one of the two minibatches of each of three epochs
    assert all(bool(jp.isfinite(x).all()) for x in jax.tree.leaves((after, metrics)))
    assert float(_update(learned, rollout, key)[1]["skipped_updates"]) == 0


def test_explained_variance():
    rollout = _rollout()
    target = (_data(rollout).advantage + rollout.value[:-1]) * (1 - rollout.reset)

    def explained(value, advantage):
        data = dataclasses.replace(_data(rollout), advantage=advantage)
        data = dataclasses.replace(data, rollout=dataclasses.replace(rollout, value=value))
        return float(lib.explained_variance(data))

    last = rollout.value[-1:]
    np.testing.assert_allclose(explained(jp.concatenate([target, last]), 0 * target), 1.0, atol=1e-6)
    np.testing.assert_allclose(explained(0 * rollout.value, target), 0.0, atol=1e-6)
    half = explained(jp.concatenate([0.5 * target, last]), 0.5 * target)
    np.testing.assert_allclose(half, 0.75, atol=1e-5)


def test_separate_optimisers_clip_and_step_each_by_itself(learned, key):
    """By hand: the gradients of the two losses, each clipped to norm 0.5, each through an Adam of its own."""
    config = dataclasses.replace(CONFIG, optimizer="separate", minibatch=STEPS * ENVS, epochs=1)
    rows = jp.arange(STEPS * ENVS, dtype=jp.int32)
    params, optimizer = learned[0], lib.make_optimizer(config)
    data = _data(_rollout())
    grads, _ = jax.jit(lambda: lib.gradient(NETWORKS, config, params, data, rows))()
    joint, _ = jax.jit(lambda: lib.gradient(NETWORKS, CONFIG, params, data, rows))()
    _assert_close(jax.tree.map(jp.add, grads["policy"], grads["value"]), joint, rtol=1e-4, atol=1e-6)
    # What serves one alone has no gradient of the other.
    assert float(jp.abs(grads["policy"]["params"]["Dense_1"]["kernel"]).max()) == 0
    assert float(jp.abs(grads["value"]["params"]["Dense_0"]["kernel"]).max()) == 0
    (after, _), _ = lib.apply_gradients(config, (params, optimizer.init(params)), grads, jp.array(1e-2))

    def step(grads):
        norm = np.sqrt(sum(float((g**2).sum()) for g in jax.tree.leaves(grads)))
        return jax.tree.map(lambda g: (c := g * min(1.0, 0.5 / norm)) / (jp.abs(c) + 1e-5), grads)

    expected = jax.tree.map(lambda p, a, b: p - 1e-2 * (a + b), params, step(grads["policy"]), step(grads["value"]))
    _assert_close(after, expected, rtol=1e-3, atol=1e-5)
