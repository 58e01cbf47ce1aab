"""Probe environments that only a working PPO solves."""

from __future__ import annotations

import jax.numpy as jp
import numpy as np

from loco_mjx.ppo.trainer import Trainer
from tests.ppo.probes import DelayedProbe, DepthSignProbe, EndingProbe, tiny


def _train(config, env, iterations):
    trainer = Trainer(config, env)
    state = trainer.init()
    for i in range(iterations):
        state, metrics = trainer.iterate(state, trainer.make_pool(i))
    return trainer, state, {name: float(value) for name, value in metrics.items()}


def _outputs(trainer, state, observations):
    inputs = jp.array(observations, jp.float32)
    normalized = (inputs - state.normalizer.mean) / jp.sqrt(state.normalizer.squares / state.normalizer.count + 1e-8)
    return trainer.networks.apply(state.params, {"state": normalized})


def test_values_of_terminated_and_truncated_episodes():
    """γ = 0.8, reward 1: 1 + γ then 1 before a termination; 1 / (1 − γ) before a truncation, for ever."""
    trainer, state, metrics = _train(tiny(discount=0.8, epochs=8), EndingProbe(), 40)
    values = _outputs(trainer, state, [[-1, 0], [-1, 0.5], [1, 0]]).value
    np.testing.assert_allclose(values, [1.8, 1.0, 5.0], rtol=0.1)
    assert metrics["value/explained_variance"] > 0.9


def test_credit_for_a_delayed_reward():
    """The last of three steps pays for the first step's action."""
    _, _, metrics = _train(tiny(), DelayedProbe(), 30)
    assert metrics["episode/return"] > 0.8  # of at most 1; 0 by chance


def test_policy_reads_the_depth_image():
    """The sign shows in the image only."""
    config = tiny("loco-transformer", learning_rate=2e-3, epochs=3)
    _, _, metrics = _train(config, DepthSignProbe(), 12)
    assert metrics["step/reward"] > 0.8  # 0 without looking
