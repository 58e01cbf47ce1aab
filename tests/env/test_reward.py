"""Each reward term and termination by hand-computed numbers."""

import dataclasses

import jax.numpy as jp
import pytest

from loco_mjx import ranges
from loco_mjx.config import Config, EnvConfig, RewardConfig, TerminationConfig, from_dict, to_dict
from loco_mjx.config.reward_terms import REWARDS
from loco_mjx.env.reward import (
    RewardInputs,
    forward_displacement,
    forward_speed,
    register_reward,
    rewards,
    terminated,
)
from tests.refusals import refusal

STEP = RewardInputs(
    displacement=jp.array([0.02, -0.01, 0.004]),
    velocity=jp.array([0.5, -0.25, 0.1]),
    forward=jp.array(0.02),
    forward_velocity=jp.array(0.5),
    speed=jp.array(0.5),
    distance=jp.array(0.02),
    goal_distance=jp.array(jp.inf),
    torque_squared=jp.array(80.0),
    spheres=jp.array(2.0),
    contact=jp.array(True),
    passed=jp.array(True),
    dropped=jp.zeros(()),
    action=jp.zeros(12),
    last_action=jp.zeros(12),
    action_change=jp.array(0.25),
    up=jp.array(0.9),
    height=jp.array(0.25),
    qpos=jp.zeros(19),
    qvel=jp.zeros(18).at[6:].set(2.0),
    finite=jp.array(True),
)


def test_the_papers_terms_at_their_weights():
    terms = rewards(STEP, RewardConfig())
    assert terms["forward"] == pytest.approx(0.5)  # m/s
    assert terms["energy"] == pytest.approx(-0.005 * 0.0025 * 80)  # −0.001
    assert terms["alive"] == pytest.approx(0.1)
    assert terms["sphere"] == pytest.approx(200.0)
    assert terms["vertical_speed"] == terms["collision"] == terms["action_rate"] == 0.0


def test_the_further_terms_when_weighted():
    terms = rewards(STEP, RewardConfig(vertical_speed=2.0, collision=3.0, action_rate=4.0, energy=0.005))
    assert terms["vertical_speed"] == pytest.approx(-2.0 * 0.1**2)
    assert terms["collision"] == pytest.approx(-3.0)
    assert terms["action_rate"] == pytest.approx(-1.0)
    assert terms["energy"] == pytest.approx(-0.4)


@pytest.mark.parametrize(("forward", "target", "expected"), [(0.08, 1.0, 1.0), (0.08, None, 2.0), (-0.08, 1.0, -2.0)])
def test_forward_speed_is_capped_above_only(forward, target, expected):
    assert forward_speed(jp.array(forward / 0.04), RewardConfig(target_speed=target)) == pytest.approx(expected)


def test_forward_is_plus_x_or_three_dimensional_progress_to_the_goal():
    before, after, goal = jp.zeros(3), jp.array([0.03, 0.04, 0.0]), jp.array([0.0, 3.0, 4.0])
    assert forward_displacement(before, after, goal, toward_goal=False) == pytest.approx(0.03)
    # from 5 m to sqrt(0.03² + 2.96² + 4²) m
    expected = 5.0 - (0.03**2 + 2.96**2 + 16.0) ** 0.5
    assert forward_displacement(before, after, goal, toward_goal=True) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("up", "height", "on_collision", "ends"),
    [(0.9, 0.25, False, False), (0.59, 0.25, False, True), (0.9, 0.149, False, True), (0.9, 0.25, True, True)],
)
def test_termination_by_tilt_height_and_on_request_collision(up, height, on_collision, ends):
    step = dataclasses.replace(STEP, up=jp.array(up), height=jp.array(height))
    assert bool(terminated(step, TerminationConfig(on_collision=on_collision))) is ends


@pytest.fixture
def smooth():
    register_reward("smooth", lambda step: -jp.sum(step.qvel[6:] ** 2), weight=0.01)
    yield "smooth"
    REWARDS.unregister("smooth")


def test_a_registered_term_has_its_default_weight_until_the_configuration_says_another(smooth):
    assert RewardConfig().terms == {"smooth": 0.01}
    assert rewards(STEP, RewardConfig())["smooth"] == pytest.approx(-0.01 * 12 * 4.0)
    assert rewards(STEP, RewardConfig(terms={"smooth": 0.5}))["smooth"] == pytest.approx(-0.5 * 12 * 4.0)


def test_a_term_without_weight_is_not_computed(smooth):
    def never(step):
        raise AssertionError

    register_reward("never", never, weight=0.0)
    try:
        assert "never" not in rewards(STEP, RewardConfig())
        assert "smooth" not in rewards(STEP, RewardConfig(terms={}))
    finally:
        REWARDS.unregister("never")


def test_a_configuration_that_was_written_before_a_term_was_registered_is_without_it(smooth):
    before = to_dict(Config())
    del before["env"]["reward"]["smooth"]
    assert from_dict(Config, before).env.reward.terms == {}
    assert from_dict(Config, {}).env.reward.terms == {}
    assert to_dict(Config())["env"]["reward"]["smooth"] == 0.01
    assert from_dict(Config, to_dict(Config())) == Config() and hash(Config())


def test_what_is_no_term_is_refused(smooth):
    with refusal("reward smoth smooth"):
        rewards(STEP, RewardConfig(terms={"smoth": 1.0}))
    with refusal("reward smooth already"):
        register_reward("smooth", lambda step: step.up)
    for name, said in (
        ("alive", "env.reward.alive already"),
        ("target_speed", "env.reward.target_speed already"),
        ("My-term", "My-term name"),
    ):
        with refusal(said):
            register_reward(name, lambda step: step.up)
    with refusal("env.reward.smooth nan -10000 10000"):
        ranges.check(Config(env=EnvConfig(reward=RewardConfig(terms={"smooth": float("nan")}))))
    register_reward("wide", lambda step: step.qpos)
    try:
        with refusal("wide (19,) ()"):
            rewards(STEP, RewardConfig())
    finally:
        REWARDS.unregister("wide")
