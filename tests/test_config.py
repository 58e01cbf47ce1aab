"""The configuration: what is refused, and that it survives being written down."""

import dataclasses
import json

import jax
import pytest

from loco_mjx import config as config_lib
from loco_mjx.cli import train
from loco_mjx.config import Config
from loco_mjx.env import LocoEnv
from loco_mjx.ppo.trainer import Trainer
from tests.refusals import refusal


def _with(path: str, value):
    """A configuration with one value changed."""

    def change(node, names):
        name, *rest = names
        return dataclasses.replace(node, **{name: change(getattr(node, name), rest) if rest else value})

    return change(Config(), path.split("."))


@pytest.mark.parametrize("name", config_lib.PRESETS)
def test_presets_are_sound_and_survive_json(name):
    config = config_lib.preset(name)
    config_lib.check(config, num_devices=2)
    assert config_lib.from_dict(Config, json.loads(json.dumps(config_lib.to_dict(config)))) == config


def test_paper_preset_is_the_papers():
    ppo = config_lib.preset("paper").ppo
    assert ppo.samples_per_iteration == 8192 and ppo.minibatch == 256 and ppo.epochs == 3 and ppo.learning_rate == 1e-4
    assert ppo.total_steps == 15_000_000 and ppo.iterations == 1832 and ppo.learning_rate_decay
    assert ppo.optimizer == "separate" and ppo.value_loss == 1.0  # as in the authors' code


def test_real_preset_is_the_fast_one_without_what_the_robot_cannot_measure():
    fast, real = config_lib.preset("fast"), config_lib.preset("real")
    assert (real.ppo, real.network, real.env.action) == (fast.ppo, fast.network, fast.env.action)
    env, observation = real.env, real.env.observation
    assert (observation.displacement, observation.depth.noise, env.randomization.enabled) == (False, True, True)
    depth = dataclasses.replace(observation.depth, noise=None)
    observation = dataclasses.replace(observation, displacement=True, depth=depth)
    randomization = dataclasses.replace(env.randomization, enabled=False)
    assert dataclasses.replace(env, observation=observation, randomization=randomization) == fast.env


@pytest.mark.parametrize("name", config_lib.PRESETS)
def test_the_whole_body_controllers_policies_are_the_papers(name):
    config = config_lib.preset(name, controller="mpc")
    config_lib.check(config, num_devices=2)
    env = config.env
    assert (env.horizon, config.ppo.samples_per_iteration, env.action_size) == (500, 4096, 2)
    assert (env.reward.forward, env.reward.energy, env.reward.alive) == (0.5, 0.0, 0.1)
    assert not env.randomization.enabled and env.observation.state_size == 6
    assert config.network == config_lib.preset(name).network
    assert train.configuration(train.read(["--preset", name, "--controller", "mpc"])) == config
    assert train.configuration(train.read(["--preset", name, "--env.controller=mpc"])) == config
    assert config_lib.with_keys(config_lib.preset(name), [("env.controller", "mpc")]) == config


def test_what_is_chosen_beside_a_controller_stays_and_leaving_it_leaves_nothing():
    chosen = config_lib.with_keys(Config(), [("env.horizon", "80"), ("env.controller", "mpc")])
    assert (chosen.env.horizon, chosen.env.reward.forward) == (80, 0.5)
    assert config_lib.with_controller(config_lib.with_controller(Config(), "mpc"), "pd") == Config()


def test_an_observation_of_nothing_is_refused():
    config = config_lib.preset("fast", controller="mpc")
    observed = dataclasses.replace(config.env.observation, velocity=False, attitude=False)
    with refusal("env.observation True"):
        config_lib.check(dataclasses.replace(config, env=dataclasses.replace(config.env, observation=observed)))


@pytest.mark.parametrize("policy", ["state-only", "loco-transformer"])
def test_the_command_trains_the_real_preset_on_84_numbers(policy):
    sizes = ["--num-envs", "2", "--ppo.unroll", "4", "--ppo.minibatch", "4", "--ppo.pool-size", "2"]
    config = train.configuration(train.read(["--preset", "real", "--policy", policy, *sizes]))
    trainer = Trainer(config, LocoEnv(config.env))
    pool = jax.eval_shape(trainer.make_pool, 0)
    state = jax.eval_shape(trainer.start, jax.random.PRNGKey(0), pool)
    assert state.env_state.obs["state"].shape == (2, 84)
    assert ("pixels/depth" in state.env_state.obs) == (policy == "loco-transformer")
    after, metrics = jax.eval_shape(trainer.step, state, pool)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), after) == jax.tree.map(lambda x: (x.shape, x.dtype), state)
    assert "loss/total" in metrics


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("ppo.minibatch", 300, "ppo.minibatch 300 8192"),
        ("ppo.num_envs", 0, "ppo.num_envs 0 1"),
        ("ppo.learning_rate", -1.0, "ppo.learning_rate -1.0 1"),
        ("ppo.discount", 1.5, "ppo.discount 1.5 1"),
        ("env.horizon", 0, "env.horizon 0 1"),
        ("env.randomization.kp", (90.0, 40.0), "env.randomization.kp (90.0, 40.0)"),
        ("env.observation.depth.near", 20.0, "env.observation.depth near 20.0 far 10.0"),
        ("env.observation.depth.blind_min", 31, "env.observation.depth blind_min 31 blind_max 30"),
        ("network.tokens_per_side", 3, "network.tokens_per_side 3 1 2 4"),
    ],
)
def test_what_does_not_fit_is_named(path, value, message):
    with refusal(message):
        config_lib.check(_with(path, value))


def test_environments_must_divide_over_the_devices():
    with refusal("ppo.num_envs 256 3"):
        config_lib.check(Config(), num_devices=3)


def test_keys_of_another_version_are_named():
    values = config_lib.to_dict(Config())
    values["ppo"]["clip_range"] = values["ppo"].pop("clip")
    with refusal("PPOConfig clip_range"):
        config_lib.from_dict(Config, values)


def test_keys_that_an_older_version_did_not_have_take_their_defaults():
    values = config_lib.to_dict(dataclasses.replace(Config(), seed=3))
    del values["network"]["hold"], values["env"]["observation"]["depth"]["noise"]
    assert config_lib.from_dict(Config, values) == dataclasses.replace(Config(), seed=3)
