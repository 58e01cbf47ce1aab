"""The Gaussian against closed forms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.ppo import distribution


def test_log_prob_is_the_product_of_normal_densities():
    action, mean, std = np.array([0.3, -2.0, 1.0]), np.array([0.1, -1.0, 1.0]), np.array([0.5, 2.0, 3.0])
    density = np.exp(-0.5 * ((action - mean) / std) ** 2) / (std * math.sqrt(2 * math.pi))
    got = distribution.log_prob(jp.array(action), jp.array(mean), jp.log(std))
    np.testing.assert_allclose(got, np.log(density.prod()), rtol=1e-5)


def test_entropy_is_the_expected_surprise(key):
    mean, log_std = jp.array([0.5, -1.0]), jp.array([-0.7, 0.4])
    closed = 0.5 * math.log((2 * math.pi * math.e) ** 2 * math.exp(2 * (-0.7 + 0.4)))
    np.testing.assert_allclose(distribution.entropy(log_std), closed, rtol=1e-6)
    shape = (40_000, 2)
    actions = distribution.sample(key, jp.broadcast_to(mean, shape), jp.broadcast_to(log_std, shape))
    # Standard deviation of the mean: 1 / sqrt(40,000) = 0.005.
    np.testing.assert_allclose(-distribution.log_prob(actions, mean, log_std).mean(), closed, atol=0.03)


def test_samples_have_the_mean_and_deviation(key):
    shape = (40_000, 2)
    mean, std = jp.array([0.5, -1.0]), jp.array([0.2, 2.0])
    actions = distribution.sample(key, jp.broadcast_to(mean, shape), jp.broadcast_to(jp.log(std), shape))
    np.testing.assert_allclose(actions.mean(0), mean, atol=0.05)
    np.testing.assert_allclose(actions.std(0), std, rtol=0.03)
    correlation = np.corrcoef(np.asarray(actions).T)[0, 1]
    assert abs(correlation) < 0.03
    assert actions.dtype == jp.float32
    assert not jax.numpy.array_equal(actions[0], actions[1])
