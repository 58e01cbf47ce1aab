"""Each reward term and termination by hand-computed numbers."""

import dataclasses

import jax.numpy as jp
import pytest

from loco_mjx.config import RewardConfig, TerminationConfig
from loco_mjx.env.reward import StepFacts, forward_displacement, rewards, terminated

DT = 0.04  # s
FACTS = StepFacts(
    displacement=jp.array([0.02, -0.01, 0.004]),
    forward=jp.array(0.02),
    torque_squared=jp.array(80.0),
    spheres=jp.array(2.0),
    dropped=jp.zeros(()),
    contact=jp.array(True),
    action_change=jp.array(0.25),
    up=jp.array(0.9),
    height=jp.array(0.25),
)


def test_the_papers_terms_at_their_weights():
    terms = rewards(FACTS, RewardConfig(), DT)
    assert terms["forward"] == pytest.approx(0.5)  # 0.02 m / 0.04 s
    assert terms["energy"] == pytest.approx(-0.005 * 0.0025 * 80)  # −0.001
    assert terms["alive"] == pytest.approx(0.1)
    assert terms["sphere"] == pytest.approx(200.0)
    assert terms["vertical_speed"] == terms["collision"] == terms["action_rate"] == 0.0


def test_the_further_terms_when_weighted():
    terms = rewards(FACTS, RewardConfig(vertical_speed=2.0, collision=3.0, action_rate=4.0, energy=0.005), DT)
    assert terms["vertical_speed"] == pytest.approx(-2.0 * 0.1**2)
    assert terms["collision"] == pytest.approx(-3.0)
    assert terms["action_rate"] == pytest.approx(-1.0)
    assert terms["energy"] == pytest.approx(-0.4)


@pytest.mark.parametrize(("forward", "target", "expected"), [(0.08, 1.0, 1.0), (0.08, None, 2.0), (-0.08, 1.0, -2.0)])
def test_forward_speed_is_capped_above_only(forward, target, expected):
    facts = dataclasses.replace(FACTS, forward=jp.array(forward))
    assert rewards(facts, RewardConfig(target_speed=target), DT)["forward"] == pytest.approx(expected)


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
    facts = dataclasses.replace(FACTS, up=jp.array(up), height=jp.array(height))
    assert bool(terminated(facts, TerminationConfig(on_collision=on_collision))) is ends
