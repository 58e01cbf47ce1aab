"""What is drawn for an episode: every quantity from the range of its own name."""

import dataclasses

import jax
import numpy as np
import pytest

from loco_mjx.config import EnvConfig, RandomizationConfig
from loco_mjx.env import randomization
from loco_mjx.physics.step import Dynamics

CONFIG = EnvConfig(randomization=RandomizationConfig(enabled=True))
NAMES = [*(field.name for field in dataclasses.fields(Dynamics)), "latency"]


@pytest.fixture(scope="module")
def drawn():
    keys = jax.random.split(jax.random.PRNGKey(1), 500)
    found = jax.vmap(lambda key: randomization.draw(key, CONFIG))(keys)
    return {name: np.asarray(getattr(found.dynamics, name, found.latency)) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_every_quantity_fills_the_range_of_its_name(name, drawn):
    low, high = getattr(CONFIG.randomization, name)
    assert low <= drawn[name].min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < drawn[name].max() <= high


def test_quantities_and_motors_are_drawn_by_themselves(drawn):
    assert drawn["motor_strength"].shape == (500, 12)
    columns = [drawn[name].reshape(500, -1)[:, 0] for name in NAMES] + [drawn["motor_strength"][:, 1]]
    correlations = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlations).max() < 0.2


def test_every_range_is_of_something_that_is_drawn():
    keys = {field.name for field in dataclasses.fields(RandomizationConfig)} - {"enabled"}
    assert keys == set(NAMES)


def test_without_randomization_the_robot_is_as_specified():
    robot = randomization.draw(jax.random.PRNGKey(0), EnvConfig(kp=33.0))
    assert robot.latency == 0.0 and robot.dynamics.kp == 33.0 and robot.dynamics.motor_friction == 0.0
    assert (np.asarray(robot.dynamics.motor_strength) == 1.0).all()
