import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import preset
from loco_mjx.env.state import State
from loco_mjx.evaluation.episodes import EARLY_SECONDS, Evaluator, evaluation_config, means, summarize
from loco_mjx.networks.outputs import Outputs
from loco_mjx.ppo import normalizer
from tests.refusals import refusal
from tests.run.tiny import mesh

HORIZON = 6


class Staircase:
    """Step t is worth t; `end` is drawn from 2..4 or is beyond the horizon; after it everything is worth 1000."""

    dt = 16 / 3  # s

    def reset(self, key):
        end = 2 + jax.random.randint(key, (), 0, 4)
        end = jp.where(end == 5, HORIZON + 10, end)
        zero = jp.zeros(())
        info = {"t": zero, "end": end.astype(jp.float32), "truncation": zero}
        metrics = {"distance": zero, "collisions": zero, "speed": zero, "action": zero, "end": zero, "at_goal": zero}
        return State(None, {"state": jp.zeros(2)}, zero, zero, metrics, info)

    def step(self, state, action):
        t, end = state.info["t"] + 1, state.info["end"]
        over = t > end
        worth = jp.where(over, 1000.0, t)
        truncated = (t >= HORIZON).astype(jp.float32)
        done = jp.where(over, 0.0, jp.maximum((t == end).astype(jp.float32), truncated))
        metrics = {"distance": worth, "collisions": 2.0 * (t > 1), "speed": worth, "action": action[0]}
        metrics["at_goal"] = (t >= 3).astype(jp.float32)
        metrics["end"] = jp.where(t == 1, end, 0.0)
        info = state.info | {"t": t, "truncation": truncated * (t != end)}
        return state.replace(reward=2 * worth, done=done, metrics=metrics, info=info)


class Constant:
    """A policy whose mean is atanh(0.5)."""

    hold = 1

    def apply(self, params, obs):
        shape = obs["state"].shape[:-1]
        mean = jp.full((*shape, 1), jp.arctanh(0.5))
        return Outputs(mean, jp.zeros((*shape, 1)), jp.zeros(shape))


def run(episodes, seed=0, deterministic=True):
    evaluator = Evaluator(Staircase(), Constant(), HORIZON, mesh(), deterministic)
    return evaluator.run({}, normalizer.create(2), seed, episodes)


def test_metrics_are_sums_up_to_the_first_done():
    figures = run(16)
    ends = figures["end"]
    assert set(ends) == {2.0, 3.0, 4.0, HORIZON + 10.0}
    length = np.minimum(ends, HORIZON)
    np.testing.assert_array_equal(figures["length"], length)
    np.testing.assert_array_equal(figures["distance"], length * (length + 1) / 2)  # 1 + 2 + … + length
    np.testing.assert_array_equal(figures["return"], length * (length + 1))
    np.testing.assert_array_equal(figures["speed"], (length + 1) / 2)  # a mean, unlike the others
    np.testing.assert_array_equal(figures["survived"], ends > HORIZON)
    np.testing.assert_array_equal(figures["at_goal"], np.maximum(length - 2, 0))
    np.testing.assert_array_equal(figures["reached_goal"], length >= 3)


def test_the_first_16_seconds_are_summed_apart():
    assert EARLY_SECONDS == 16 == 3 * Staircase.dt
    figures = run(16)
    early = np.minimum(figures["length"], 3)
    assert set(early) == {2.0, 3.0}
    np.testing.assert_array_equal(figures["distance_16s"], early * (early + 1) / 2)
    np.testing.assert_array_equal(figures["collisions_16s"], 2 * (early - 1))
    np.testing.assert_array_equal(figures["collisions"], 2 * (figures["length"] - 1))


def test_collisions_per_metre_are_all_collisions_over_all_metres():
    """Not the mean of 10 / 0.001 and 2 / 9."""
    walked = {"distance": np.array([0.001, 9.0]), "collisions": np.array([10.0, 2.0])}
    found = summarize(walked)["collisions_per_metre"]
    assert found["mean"] == pytest.approx(12 / 9.001)
    # The deviation of a ratio by its linearisation: of 10 − r 0.001 and 2 − r 9 over 4.5005.
    assert found["std"] == pytest.approx((8 + 8.999 * found["mean"]) / 2 / 4.5005)
    assert means(walked)["collisions_per_metre"] == found["mean"]
    standing = {"distance": np.array([-0.02, 0.3]), "collisions": np.array([10.0, 2.0])}
    assert "collisions_per_metre" not in summarize(standing)


def test_the_deterministic_policy_acts_by_the_squashed_mean():
    figures = run(4)
    np.testing.assert_allclose(figures["action"] / figures["length"], 0.5, rtol=1e-6)
    drawn = run(4, deterministic=False)
    assert np.std(drawn["action"] / drawn["length"]) > 0.01


@pytest.mark.parametrize("deterministic", [True, False])
def test_an_episode_does_not_depend_on_how_many_run_beside_it(deterministic, monkeypatch):
    whole = run(7, deterministic=deterministic)
    monkeypatch.setattr("loco_mjx.evaluation.episodes.CHUNK", 2)
    for name, values in run(5, deterministic=deterministic).items():
        assert values.shape == (5,)
        np.testing.assert_allclose(values, whole[name][:5], rtol=1e-6)


def test_seeds_give_other_episodes_and_the_same_again():
    assert np.array_equal(run(16, seed=1)["end"], run(16, seed=1)["end"])
    assert not np.array_equal(run(16, seed=1)["end"], run(16, seed=2)["end"])


def test_no_episodes_are_refused():
    with refusal("episodes 0 1"):
        run(0)


def test_mean_and_standard_deviation():
    figures = {"distance": np.array([1.0, 3.0])}
    assert means(figures) == {"distance": 2.0}
    assert summarize(figures) == {"distance": {"mean": 2.0, "std": 1.0}}


def test_evaluation_turns_noise_off_unless_asked_and_changes_nothing_else():
    env = preset("fast").env
    depth = dataclasses.replace(env.observation.depth, noise=True)
    noisy = dataclasses.replace(
        env,
        observation=dataclasses.replace(env.observation, depth=depth),
        randomization=dataclasses.replace(env.randomization, enabled=True),
    )
    assert evaluation_config(noisy) == env
    assert evaluation_config(noisy, "wide") == dataclasses.replace(env, task="wide")
    assert evaluation_config(noisy, "").task == ""  # which no environment is made of
    assert evaluation_config(env, randomize=True).randomization.enabled


class Watcher(Constant):
    """A policy that acts by the brightness of the depth it is shown, which it holds for 3 steps."""

    hold = 3

    def apply(self, params, obs):
        outputs = super().apply(params, obs)
        return outputs.replace(mean=jp.arctanh(0.01 * obs["pixels/depth"][..., 0, 0, :1]))


class Dial(Staircase):
    """Shows the step's number as depth; the metric adds up the actions."""

    def reset(self, key):
        state = super().reset(key)
        return state.replace(obs=state.obs | {"pixels/depth": jp.zeros((1, 1, 4))})

    def step(self, state, action):
        after = super().step(state, action)
        return after.replace(obs=after.obs | {"pixels/depth": state.obs["pixels/depth"] + 1.0})


def test_a_held_view_is_renewed_by_the_episodes_clock():
    evaluator = Evaluator(Dial(), Watcher(), HORIZON, mesh(), deterministic=True)
    figures = evaluator.run({}, normalizer.create(2), 0, 16)
    # Step t shows t, held as 0, 0, 0, 3, 3, 3; an episode's sum stops at its end.
    expected = {2: 0.0, 3: 0.0, 4: 0.03, 6: 0.09}
    assert set(figures["length"]) == set(expected)
    np.testing.assert_allclose(figures["action"], [expected[n] for n in figures["length"]], atol=1e-4)
