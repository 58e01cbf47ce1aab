"""Imitating a teacher, and going on by PPO from there."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx import config as config_lib
from loco_mjx.config import Config, DistillConfig, EnvConfig, RewardConfig
from loco_mjx.networks.outputs import PRIVILEGED, STATE
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.distill import DistillTrainer, Teacher
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.run import directory
from loco_mjx.sharding import make_mesh
from tests.ppo.probes import SignProbe, tiny
from tests.refusals import refusal

ROOT = Path(__file__).parents[2]
IMITATIONS, ITERATIONS = 24, 26


@dataclass(frozen=True)
class KnownProbe(SignProbe):
    """The sign is also `privileged`."""

    @property
    def observation_size(self):
        return super().observation_size | {PRIVILEGED: (1,)}

    def observe(self, state):
        state = super().observe(state)
        return state.replace(obs=state.obs | {PRIVILEGED: state.pipeline_state["sign"][None]})


def _config():
    config = tiny(minibatch=32, total_steps=128 * ITERATIONS, average=0.5)
    distill = DistillConfig(imitation=IMITATIONS / ITERATIONS, learning_rate=3e-3, minibatch=32, epochs=4)
    return config_lib.with_method(dataclasses.replace(config, method="distill", distill=distill))


def _teacher(config):
    """One whose answers to the two signs are far apart."""
    networks = make_networks("privileged", dataclasses.replace(config.network, critic="shared"), 1)
    blank = {STATE: jp.zeros((1, 2)), PRIVILEGED: jp.zeros((1, 1))}
    params = jax.device_get(networks.init(jax.random.PRNGKey(5), blank))
    sign = {STATE: jp.zeros((2, 2)), PRIVILEGED: jp.array([[1.0], [-1.0]])}
    mean = params["params"]["policy_head"]["mean"]["output"]
    mean["kernel"] = mean["kernel"] * 1e3
    raw = np.asarray(networks.apply(params, sign).mean)
    mean["kernel"] = mean["kernel"] * -1.5 / (raw[0] - raw[1])
    middle = np.asarray(networks.apply(params, sign).mean).mean()
    mean["bias"] = mean["bias"] - middle
    normalizer = dataclasses.replace(normalizer_lib.create(2), count=jp.array(1e6), squares=jp.full(2, 1e6))
    return Teacher(params, normalizer), networks


@pytest.fixture(scope="module")
def run():
    """The trainer, and states and metrics of every iteration."""
    config = _config()
    teacher, networks = _teacher(config)
    trainer = DistillTrainer(config, KnownProbe(), teacher, make_mesh(jax.devices()[:2]))
    state = trainer.init()
    states, rows = [jax.device_get(state)], []
    for i in range(ITERATIONS):
        state, metrics = trainer.iterate(state, trainer.make_pool(i))
        states.append(jax.device_get(state))
        rows.append(jax.device_get(metrics))
    return trainer, teacher, networks, states, rows


def _obs():
    return {STATE: jp.array([[1.0, 0.25], [-1.0, 0.5]]), PRIVILEGED: jp.array([[1.0], [-1.0]])}


def test_the_policy_comes_to_act_as_its_teacher(run):
    trainer, teacher, networks, states, rows = run
    assert trainer.imitation_iterations == IMITATIONS
    wanted = jp.tanh(networks.apply(teacher.params, _obs()).mean)
    before, after = (jp.tanh(trainer.networks.apply(states[i].params, _obs()).mean) for i in (0, IMITATIONS))
    assert float(jp.abs(before - wanted).min()) > 0.3
    np.testing.assert_allclose(after, wanted, atol=0.1)
    assert rows[IMITATIONS - 1]["loss/imitation"] < 0.05 * rows[0]["loss/imitation"]


def test_it_starts_with_the_teachers_value_and_statistics(run):
    trainer, teacher, networks, states, _ = run
    values = networks.apply(teacher.params, _obs()).value
    np.testing.assert_allclose(trainer.networks.apply(states[0].params, _obs()).value, values, rtol=1e-5)
    jax.tree.map(np.testing.assert_array_equal, states[0].normalizer, teacher.normalizer)
    # The value learns all the while: that of a policy that imitates is not its teacher's.
    drift = jp.abs(trainer.networks.apply(states[IMITATIONS].params, _obs()).value - values)
    assert float(drift.max()) > 0.1


def test_the_teacher_and_the_exploration_stay(run):
    _, teacher, _, states, rows = run
    jax.tree.map(np.testing.assert_array_equal, states[-1].teacher, teacher)
    np.testing.assert_allclose([row["policy/std"] for row in rows[:IMITATIONS]], 0.3, rtol=1e-5)


def test_imitation_is_compiled_once(run):
    """A weak type at the start, gone after an iteration, would make two programs of it."""
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(run[0].init()))


def test_then_ppo_goes_on(run):
    _, _, _, states, rows = run
    assert all(("loss/imitation" in row) == (i < IMITATIONS) for i, row in enumerate(rows))
    assert all(("loss/policy" in row) == (i >= IMITATIONS) for i, row in enumerate(rows))
    # From there the exploration is learned, too.
    before, after = (states[i].params["params"]["policy_head"]["log_std"] for i in (IMITATIONS, -1))
    assert np.all(before != after)
    assert int(states[-1].iteration) == ITERATIONS


def test_the_policy_is_a_mean_from_the_first_iteration_on_and_beyond_the_last_imitation(run):
    *_, states, _ = run
    assert config_lib.teacher_of(_config()).ppo.average == 0.5
    jax.tree.map(np.testing.assert_array_equal, states[0].policy, states[0].params)
    mean = states[1].params
    for state in states[2:]:  # half of it is new each time
        mean = jax.tree.map(lambda x, y: 0.5 * (x + y), mean, state.params)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-6), states[-1].policy, mean)


def test_adam_begins_anew_with_ppo(run):
    """Its moments after imitation are of the gradients of another loss."""
    trainer, _, _, states, _ = run
    ppo = trainer.config.ppo
    updates = ppo.epochs * ppo.samples_per_iteration // ppo.minibatch
    counts = [leaf for leaf in jax.tree.leaves(states[IMITATIONS + 1].opt_state) if leaf.dtype == jp.int32]
    assert [int(count) for count in counts] == [updates] * 2  # the policy's and the value's


def test_the_rate_falls_where_it_is_asked_to(run):
    trainer, teacher, *_ = run
    assert [float(trainer.imitation_rate(jp.array(i))) for i in (0, IMITATIONS)] == pytest.approx([3e-3, 3e-3])
    falling = dataclasses.replace(trainer.config.distill, learning_rate_decay=True)
    config = dataclasses.replace(trainer.config, distill=falling)
    other = DistillTrainer(config, KnownProbe(), teacher, make_mesh(jax.devices()[:2]))
    rates = [float(other.imitation_rate(jp.array(i))) for i in (0, IMITATIONS // 2, IMITATIONS)]
    assert rates == pytest.approx([3e-3, 3e-3 * (1 - (IMITATIONS // 2) / IMITATIONS), 0.0])


def test_what_a_run_of_this_method_is_made_of():
    config = config_lib.with_method(Config(method="distill"))
    assert config.env.observation.privileged and config.network.critic == "privileged"
    assert config.network.initial_std == config.distill.std and config.ppo.optimizer == "separate"
    teacher = config_lib.teacher_of(config)
    assert teacher.policy == "privileged" and teacher.method == "ppo" and not teacher.env.observation.depth.enabled
    assert teacher.ppo.total_steps == config.distill.teacher_ratio * config.ppo.total_steps
    assert teacher.network == dataclasses.replace(config.network, critic="shared", initial_std=1.0)
    assert teacher.ppo.final_std is None and teacher.ppo.learning_rate_decay == config.ppo.learning_rate_decay
    assert teacher.env.reward == config.env.reward


def test_a_teacher_of_other_values():
    config = dataclasses.replace(config_lib.preset("fast"), method="distill")
    assert config_lib.teacher_of(config).env.reward == dataclasses.replace(config.env.reward, collision=2.0)
    distill = DistillConfig(teacher_std=0.3, teacher_collision=0.25)
    config = dataclasses.replace(config, distill=distill, env=EnvConfig(reward=RewardConfig(collision=0.5)))
    teacher = config_lib.teacher_of(config_lib.with_method(config))
    assert teacher.env.reward.collision == 0.75
    assert teacher.ppo.final_std == 0.3 and teacher.ppo.learning_rate_decay and not config.ppo.learning_rate_decay


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"imitation": 1.5}, "distill.imitation 1.5 0 1"),
        ({"minibatch": 48}, "distill.minibatch 48"),
        ({"teacher_std": 1.5}, "distill.teacher_std 1.5 1.0"),
    ],
)
def test_values_that_do_not_fit_are_refused(values, complaint):
    config = dataclasses.replace(_config(), distill=dataclasses.replace(_config().distill, **values))
    with refusal(complaint):
        config_lib.check(config)


def test_exploration_that_is_not_the_policys_own_or_that_widens_is_refused():
    config = _config()
    with refusal("ppo.final_std 0.1 distill.teacher_std"):
        config_lib.check(dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, final_std=0.1)))
    with refusal("ppo.final_std 1.5 1.0"):
        config_lib.check(dataclasses.replace(Config(), ppo=dataclasses.replace(Config().ppo, final_std=1.5)))


def test_a_run_of_before_teachers_paid_for_collisions_is_read_as_it_was():
    before = directory.load_config(ROOT / "experiments/results/cpu/taught/thin-free-seed0")
    assert before.method == "distill" and before.distill.teacher_collision == 0.0
    assert config_lib.preset("fast").distill.teacher_collision > 0


def test_whoever_needs_privileged_observations_says_so():
    with refusal("privileged"):
        Trainer(_config(), SignProbe())
