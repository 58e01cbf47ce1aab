import dataclasses

import jax.numpy as jp
import numpy as np

from loco_mjx.config import PPOConfig
from loco_mjx.ppo import annealing


def test_learning_rate():
    config = PPOConfig(num_envs=2, unroll=5, total_steps=100, learning_rate=1e-3)
    assert config.iterations == 10
    rates = [float(annealing.learning_rate(config, jp.array(i))) for i in (0, 5, 10, 11)]
    np.testing.assert_allclose(rates, [1e-3, 5e-4, 0, 0], atol=1e-10)
    constant = dataclasses.replace(config, learning_rate_decay=False)
    np.testing.assert_allclose(annealing.learning_rate(constant, jp.array(5)), 1e-3)


def test_a_standard_deviation_narrows_geometrically_and_nothing_else_does():
    config = PPOConfig(num_envs=2, unroll=5, total_steps=100, final_std=0.01)  # 10 iterations
    params = {"params": {"policy_head": {"log_std": jp.log(jp.array([1.0, 0.05])), "bias": jp.array([7.0])}}}
    for iteration, wide, narrow in ((0, 0.01**0.1, 0.05), (4, 0.1, 0.05), (9, 0.01, 0.01), (30, 0.01, 0.01)):
        head = annealing.narrowed(params, config, 1.0, jp.array(iteration))["params"]["policy_head"]
        np.testing.assert_allclose(jp.exp(head["log_std"]), [wide, narrow], rtol=1e-5)
        assert head["bias"] == 7.0
    from_less = annealing.narrowed(params, config, 0.1, jp.array(4))["params"]["policy_head"]["log_std"]
    np.testing.assert_allclose(jp.exp(from_less), [0.1**0.5 * 0.01**0.5, 0.01**0.5 * 0.1**0.5], rtol=1e-5)
    without = dataclasses.replace(config, final_std=None)
    assert annealing.narrowed(params, without, 1.0, jp.array(30)) is params


def test_a_mean_of_parameters_weighs_the_first_alike_and_then_forgets():
    config, mean = PPOConfig(average=0.75), {"w": jp.array([100.0])}  # what was there before the first counts nothing
    expected = {0: 8.0, 1: 6.0, 2: 7.0, 3: 6.25, 4: 0.75 * 6.25 + 0.25 * 20.0, 5: 0.75 * 9.6875 + 0.25 * 1.0}
    for iteration, value in enumerate((8.0, 4.0, 9.0, 4.0, 20.0, 1.0)):
        mean = annealing.averaged(mean, {"w": jp.array([value])}, config, jp.array(iteration))
        np.testing.assert_allclose(mean["w"], [expected[iteration]], rtol=1e-6)
