"""The loss by hand, and the rows that must not count."""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PPOConfig
from loco_mjx.networks.outputs import Outputs
from loco_mjx.ppo import distribution
from loco_mjx.ppo.loss import Minibatch, loss, masked_mean, normalized_advantage

CONFIG = PPOConfig(clip=0.2, entropy=0.01, value_loss=0.5)

run_loss = jax.jit(partial(loss, config=CONFIG))


def _case(ratios, advantage, weight=None, value=0.0, target=0.0):
    """Outputs and a batch whose probability ratios are as given."""
    count = len(ratios)
    outputs = Outputs(jp.zeros((count, 1)), jp.full((count, 1), -0.5), jp.full(count, float(value)))
    action = jp.linspace(-1.0, 1.0, count)[:, None]
    new = distribution.log_prob(action, outputs.mean, outputs.log_std)
    advantage = jp.array(advantage, jp.float32)
    weight = jp.ones(count) if weight is None else jp.array(weight, jp.float32)
    batch = Minibatch(action, new - jp.log(jp.array(ratios)), target - advantage, advantage, weight)
    return outputs, batch


@pytest.mark.parametrize(
    ("ratio", "advantage", "surrogate"),
    [(1.1, 2.0, 2.2), (1.5, 2.0, 2.4), (0.5, 2.0, 1.0), (1.5, -2.0, -3.0), (0.5, -2.0, -1.6), (0.9, -2.0, -1.8)],
)
def test_clipped_surrogate(ratio, advantage, surrogate):
    outputs, batch = _case([ratio], [advantage])
    _, terms = run_loss(outputs, batch, batch.advantage, jp.array(1.0))
    np.testing.assert_allclose(terms["loss/policy"], -surrogate, rtol=1e-5)
    np.testing.assert_allclose(terms["policy/clip_fraction"], float(abs(ratio - 1) > 0.2))
    np.testing.assert_allclose(terms["policy/approx_kl"], ratio - 1 - np.log(ratio), rtol=1e-3)


def test_terms_add_up_with_their_weights():
    outputs, batch = _case([1.1, 0.9], [1.0, -1.0], value=3.0, target=1.0)
    losses, terms = run_loss(outputs, batch, batch.advantage, jp.array(2.0))
    total = losses["policy"] + losses["value"]
    entropy = 0.5 * np.log(2 * np.pi * np.e) - 0.5
    np.testing.assert_allclose(terms["loss/value"], 4.0, rtol=1e-6)
    np.testing.assert_allclose(terms["policy/entropy"], entropy, rtol=1e-6)
    np.testing.assert_allclose(terms["policy/std"], np.exp(-0.5), rtol=1e-6)
    np.testing.assert_allclose(total, -(1.1 - 0.9) / 2 + 0.5 * 4.0 - 0.01 * entropy, rtol=1e-5)


def test_reset_rows_reach_neither_loss_nor_gradient():
    weight = [1, 0, 1, 1, 0, 1]
    outputs, batch = _case([1.3, 0.6, 1.0, 0.9, 1.2, 0.7], [1.0, -2.0, 0.5, 3.0, 4.0, -1.0], weight, value=1.0)
    masked = batch.weight == 0

    @jax.jit
    def run(batch):
        advantage = normalized_advantage(batch)

        def total(o):
            losses, terms = loss(o, batch, advantage, batch.weight.sum(), CONFIG)
            return sum(losses.values()), terms

        return jax.value_and_grad(total, has_aux=True)(outputs)

    def perturbed(x):
        return jp.where(masked.reshape(-1, *[1] * (x.ndim - 1)), 37.0, x)

    changes = {
        f.name: perturbed(getattr(batch, f.name))
        for f in dataclasses.fields(Minibatch)
        if f.name not in ("weight", "teacher_action")
    }
    jax.tree.map(np.testing.assert_array_equal, run(batch), run(batch.replace(**changes)))
    gradient = run(batch)[1]
    np.testing.assert_array_equal(jp.abs(gradient.value) > 0, ~masked)
    # The same change elsewhere is felt.
    other = batch.replace(log_prob=batch.log_prob.at[0].add(0.1))
    assert float(run(other)[0][0]) != float(run(batch)[0][0])


def test_advantages_are_normalised_over_the_rows_that_count():
    _, batch = _case([1.0] * 5, [1.0, 2.0, 1e9, 3.0, 4.0], [1, 1, 0, 1, 1])
    got = normalized_advantage(batch)
    np.testing.assert_allclose(got, np.array([-1.5, -0.5, 0, 0.5, 1.5]) / np.sqrt(1.25), rtol=1e-5)


def test_parts_on_devices_add_up_to_the_whole():
    draw = np.random.default_rng(1)
    weight = (draw.uniform(size=8) > 0.3).astype(np.float32)
    outputs, batch = _case(np.exp(draw.normal(0, 0.3, 8)), draw.normal(size=8), weight, value=0.7)

    def run(outputs, batch, axis_name=None):
        total_weight = batch.weight.sum()
        total_weight = total_weight if axis_name is None else jax.lax.psum(total_weight, axis_name)
        return loss(outputs, batch, normalized_advantage(batch, axis_name), total_weight, CONFIG)

    whole = jax.jit(run)(outputs, batch)
    halves = jax.tree.map(lambda x: x.reshape(2, 4, *x.shape[1:]), (outputs, batch))
    parts = jax.jit(jax.vmap(lambda o, b: run(o, b, "env"), axis_name="env"))(*halves)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y.sum(0), rtol=1e-5, atol=1e-6), whole, parts)


def test_masked_mean():
    assert float(masked_mean(jp.array([1.0, jp.nan, 3.0]), jp.array([1.0, 0.0, 1.0]))) == 2.0
    assert float(masked_mean(jp.array([1.0, 2.0]), jp.zeros(2))) == 0.0
