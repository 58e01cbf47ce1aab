"""The package from Python: configurations, training with a callback, and policies that act."""

import json

import jax
import numpy as np
import pytest

import loco_mjx
from loco_mjx.config import Config, ObservationConfig, from_dict, preset, to_dict
from loco_mjx.networks.policies import Privileged
from loco_mjx.networks.registry import POLICIES
from loco_mjx.run import start
from loco_mjx.run.schedule import LoopOptions
from tests.deploy import made
from tests.refusals import refusal
from tests.run.tiny import tiny_config, tiny_trainer


def test_a_configuration_is_a_preset_with_some_keys_changed():
    keys = {"ppo.learning_rate": 3e-4, "env.action.scale": (0.1, 0.2, 0.3), "env.reward.target_speed": None}
    config = loco_mjx.configure("paper", keys, task="wide", policy="state-only", seed=4, num_envs=64, total_steps=4096)
    assert (config.policy, config.seed, config.env.task) == ("state-only", 4, "wide")
    assert (config.ppo.num_envs, config.ppo.total_steps, config.ppo.learning_rate) == (64, 4096, 3e-4)
    assert config.env.action.scale == (0.1, 0.2, 0.3) and config.env.reward.target_speed is None
    assert not config.env.observation.depth.enabled and config.ppo.optimizer == preset("paper").ppo.optimizer
    assert isinstance(config, Config) and loco_mjx.Config is Config and loco_mjx.preset is preset


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"task": "thn"}, "task thn thin"),
        ({"policy": "blind"}, "policy blind state-only"),
        ({"keys": {"ppo.learning_rat": 1.0}}, "ppo.learning_rat ppo.learning_rate"),
        ({"keys": {"ppo.clip": "wide"}}, "ppo.clip wide number"),
        ({"steps": 3}, "key steps"),
        ({"preset": "slow"}, "preset slow fast"),
    ],
)
def test_what_is_no_configuration_is_refused(changes, said):
    with refusal(said):
        loco_mjx.configure(**changes)


def test_numbers_of_numpy_are_numbers(tmp_path):
    keys = {"ppo.learning_rate": np.float32(0.5), "env.action.scale": tuple(np.array([0.25, 0.5, 0.5]))}
    config = loco_mjx.configure(seed=np.arange(4)[3], keys=keys)
    written = json.loads(json.dumps(to_dict(config)))
    assert written["seed"] == 3 and written["ppo"]["learning_rate"] == 0.5
    assert from_dict(Config, written) == config


def test_an_environment_of_another_robot_or_controller_has_what_belongs_to_it():
    go1, mpc = loco_mjx.make_env("thin", robot="go1").config, loco_mjx.make_env("thin", controller="mpc").config
    assert (go1.kp, go1.task) == (loco_mjx.configure(robot="go1").env.kp, "thin") != (Config().env.kp, "thin")
    assert mpc.observation.velocity and not mpc.observation.last_action
    with refusal("env.observation.last_action mpc"):
        loco_mjx.make_env("thin", controller="mpc", observation=ObservationConfig())
    with refusal("env.horizon -3"):
        loco_mjx.make_env("thin", horizon=-3)


def test_a_policy_of_ones_own_that_reads_what_only_a_simulator_knows_gets_it():
    loco_mjx.register_policy("knows", Privileged, uses_depth=False, uses_privileged=True)
    try:
        assert loco_mjx.configure(policy="knows").env.observation.privileged
    finally:
        POLICIES.unregister("knows")


def test_training_calls_back_after_every_iteration_stops_when_asked_and_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(start, "build", tiny_trainer)
    config, out, seen = tiny_config(), tmp_path / "run", []

    def each(samples, metrics):
        seen.append(samples)
        assert metrics["step/reward"] == metrics["step/reward"] and "loss/value" in metrics
        return samples == 64

    none = LoopOptions(evaluations=0)
    outcome = loco_mjx.train(config, out, each, options=none, quiet=True)
    assert seen == [32, 64] and outcome.samples == 64 and outcome.signal is not None
    outcome = loco_mjx.train(config, out, lambda samples, metrics: seen.append(samples), options=none, quiet=True)
    assert seen == [32, 64, 96, 128, 160, 192] and (outcome.samples, outcome.signal) == (192, None)
    assert capsys.readouterr().out == ""
    assert json.loads((out / "info.json").read_text())["command"] == ["loco_mjx.train"]


@pytest.fixture(scope="module")
def held():
    """A policy that holds what it sees for 4 steps, 9 observations of two environments, and its actions."""
    policy, views = loco_mjx.Policy(made.policy("hrl")), made.observations(18)
    obs = [{"state": views["state"][i : i + 2], "pixels/depth": views["depth"][i : i + 2]} for i in range(0, 18, 2)]
    return policy, obs, np.array([policy.act(one) for one in obs])


def test_a_policy_acts_and_holds_depth_until_it_is_reset(held):
    policy, obs, actions = held
    assert actions.shape == (9, 2, 12) and np.abs(actions).max() <= 1.0
    policy.reset()
    seen = [one | {"pixels/depth": obs[i - i % 4]["pixels/depth"]} for i, one in enumerate(obs)]
    np.testing.assert_allclose([policy.act(one) for one in seen], actions, atol=1e-6)
    policy.reset()
    moved = np.array([policy.act(one) for one in obs[1:]])
    assert np.abs(moved[0] - actions[1]).max() > 1e-3  # it looked anew


def test_a_policy_draws_with_a_key_and_says_what_it_lacks(held):
    policy, obs, actions = held
    policy.reset()
    drawn = policy.act(obs[0], jax.random.PRNGKey(0))
    assert drawn.shape == actions[0].shape and np.abs(drawn - actions[0]).max() > 1e-2
    with refusal("pixels/depth"):
        policy.act({"state": obs[0]["state"]})
    with refusal("privileged"):
        loco_mjx.Policy(made.policy("privileged")).act({"state": obs[0]["state"]})
    with refusal("nowhere"):
        loco_mjx.load_policy("nowhere")


def test_a_policy_that_reads_depth_alone_acts_on_depth_alone():
    policy, views = loco_mjx.Policy(made.policy("depth-only")), made.observations(2)
    alone = policy.act({"pixels/depth": views["depth"]})
    assert alone.shape == (2, 12) and np.abs(alone[0] - alone[1]).max() > 1e-3
    with refusal("pixels/depth"):
        policy.act({"state": views["state"]})
