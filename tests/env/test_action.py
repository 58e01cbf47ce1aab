"""From an action to joint offsets and back, for NumPy's arrays and JAX's."""

import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import ActionConfig, EnvConfig
from loco_mjx.env import action
from loco_mjx.robots import joint_names


@pytest.mark.parametrize("config", [ActionConfig(), ActionConfig((0.2, 0.5, 0.4), diagonal=True)])
def test_there_and_back(config):
    drawn = np.random.default_rng(0).uniform(-1, 1, (5, config.size))
    offsets = action.joint_scale(config) * action.per_joint(drawn, config)
    np.testing.assert_allclose(action.from_offsets(offsets, EnvConfig(action=config)), drawn)
    np.testing.assert_allclose(action.per_joint(jp.asarray(drawn), config), action.per_joint(drawn, config), rtol=1e-6)


def test_a_diagonal_pair_of_legs_moves_alike():
    whole = action.per_joint(np.arange(6), ActionConfig(diagonal=True))
    legs = {name[:2]: whole[3 * i : 3 * i + 3].tolist() for i, name in enumerate(joint_names()[::3])}
    assert legs == {"FR": [0, 1, 2], "FL": [3, 4, 5], "RR": [3, 4, 5], "RL": [0, 1, 2]}


def test_a_joint_that_an_action_cannot_move_has_the_action_0():
    config = ActionConfig((0.0, 0.5, 0.5))
    assert action.from_offsets(np.full(12, 0.1), EnvConfig(action=config))[:3].tolist() == [0.0, 0.2, 0.2]
