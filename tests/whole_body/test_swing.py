"""Footholds, and the way there."""

import numpy as np
import pytest

from loco_mjx.whole_body import swing
from tests.whole_body.walks import BODY, CONFIG

LEVEL = np.eye(3)


def test_standing_feet_land_beneath_their_legs():
    goals = swing.footholds(CONFIG, BODY, LEVEL, np.zeros(6), np.zeros(2))
    np.testing.assert_allclose(goals[:, :2], BODY.hips[:, :2] + np.stack([np.zeros(4), BODY.offsets], -1))
    np.testing.assert_allclose(goals[:, 2], -0.23)


def test_half_a_stance_ahead_and_farther_if_too_fast():
    rest = swing.footholds(CONFIG, BODY, LEVEL, np.zeros(6), np.zeros(2))
    rates = np.array([0, 0, 0, 0.4, 0, 0])
    right = swing.footholds(CONFIG, BODY, LEVEL, rates, np.array([0.4, 0.0])) - rest
    np.testing.assert_allclose(right, np.tile([0.05, 0, 0], (4, 1)), atol=1e-12)
    fast = swing.footholds(CONFIG, BODY, LEVEL, rates, np.array([0.0, 0.0])) - rest
    np.testing.assert_allclose(fast, np.tile([0.062, 0, 0], (4, 1)), atol=1e-12)


def test_turning_moves_footholds_around_the_trunk():
    rest = swing.footholds(CONFIG, BODY, LEVEL, np.zeros(6), np.zeros(2))
    turned = swing.footholds(CONFIG, BODY, LEVEL, np.array([0, 0, 0.3, 0, 0, 0]), np.array([0.0, 0.3])) - rest
    assert np.all(np.sum(turned[:, :2] * rest[:, :2], axis=1) == pytest.approx(0, abs=1e-12))
    assert np.all(rest[:, 0] * turned[:, 1] - rest[:, 1] * turned[:, 0] > 0)


def test_a_tilted_robot_steps_to_the_same_places():
    roll = 0.3
    tilt = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    goals = swing.footholds(CONFIG, BODY, tilt, np.zeros(6), np.zeros(2)) @ tilt.T
    np.testing.assert_allclose(goals[:, 2], -0.23)


def test_the_way_begins_ends_and_clears():
    start, end = np.tile([0.0, 0.1, -0.25], (4, 1)), np.tile([0.1, 0.12, -0.22], (4, 1))
    at = lambda part: swing.way(CONFIG, start, end, np.full(4, part))  # noqa: E731
    np.testing.assert_allclose(at(0.0), start, atol=1e-12)
    np.testing.assert_allclose(at(1.0), end, atol=1e-12)
    heights = [at(part)[0, 2] for part in np.linspace(0, 1, 2001)]
    assert max(heights) == pytest.approx(-0.22 + CONFIG.swing.clearance, abs=2e-3)
    assert np.all(np.diff([at(part)[0, 0] for part in np.linspace(0, 1, 101)]) > -1e-12)
