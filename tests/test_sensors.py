"""A sensor is one entry: training, the description and a robot's observer read it alike."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx import rotations, sensors
from loco_mjx.config import Config, EnvConfig, ObservationConfig
from loco_mjx.deploy import description, folder
from loco_mjx.deploy.observer import Observer
from loco_mjx.deploy.robot import Sensors
from loco_mjx.env import observation
from loco_mjx.sensors import SENSORS, Readings, Sensor
from tests.known_robots import A1

EXTENDING = Path(__file__).parents[1] / "docs" / "extending.md"
HALF = 0.15
QUAT = np.array([np.cos(HALF), np.sin(HALF), 0.0, 0.0])  # rolled by 0.3 rad


def readings(xp, rng):
    arrays = rng.normal(size=3), rng.normal(size=12), rng.normal(size=12), rng.normal(size=3), rng.normal(size=3)
    return Readings(*(xp.asarray(array) for array in (QUAT, *arrays)))


def test_a_robot_that_does_not_know_where_it_is_sets_out_along_x():
    """Its IMU's yaw is of any frame; training knows one in which robots set out along +x."""
    config = ObservationConfig(displacement=False, velocity=True, attitude=True)
    described = description.describe(Config(env=EnvConfig(observation=config)), ("state",), 1)

    def seen(yaw, later, position):
        observer, states = Observer(folder.build(described)), []
        for angle in (yaw, yaw + later):
            quat, ahead = rotations.turned(QUAT, angle), rotations.matrix(rotations.from_yaw(angle))[:, 0]
            measured = Sensors(0.0, np.zeros(12), np.zeros(12), quat, np.zeros(3), position)
            states.append(observer.observe(measured, None, np.zeros(12), ahead)["state"])
        return states[1]

    np.testing.assert_allclose(seen(2.0, 0.3, None), seen(0.0, 0.3, None), atol=1e-6)
    assert np.abs(seen(2.0, 0.3, np.zeros(3)) - seen(0.0, 0.3, np.zeros(3))).max() > 0.5


def test_every_sensor_has_its_size_and_is_the_same_for_jax_and_for_numpy():
    ours, theirs = (sensors.measure(readings(xp, np.random.default_rng(0)), SENSORS, xp) for xp in (jp, np))
    for name, sensor in SENSORS.items():
        assert ours[name].shape == theirs[name].shape == (sensor.size,)
        np.testing.assert_allclose(ours[name], theirs[name], atol=1e-6)
    assert ours["imu"][:2] == pytest.approx([0.3, 0.0], abs=1e-6)
    assert ours["attitude"] == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)


@pytest.fixture
def gravity(monkeypatch):
    """One more sensor, by one entry, that of the documents: where down is, in the trunk's frame."""
    entry = re.search(r'"gravity": (Sensor\(.*?\n\)),\n', EXTENDING.read_text(), re.DOTALL)
    monkeypatch.setitem(SENSORS, "gravity", eval(entry[1], {"Sensor": Sensor, "rotations": rotations}))


def test_a_new_sensor_is_one_entry(gravity):
    config = ObservationConfig(displacement=False)
    assert config.state_size == 3 * (4 + 12 + 12 + 3)
    history = observation.first_history(config, A1)
    np.testing.assert_allclose(history["gravity"][0], [0, 0, -1], atol=1e-6)
    assert observation.state_vector(history, None).shape == observation.shapes(config)["state"] == (93,)
    run = Config(env=EnvConfig(observation=config))
    described = description.describe(run, ("state",), 1)
    field = described["inputs"]["state"]["fields"][-1]
    assert (field["name"], field["offset"], field["size"], field["frames"]) == ("gravity", 84, 3, 3)
    manifest = folder.build(described)
    measured = Sensors(0.0, np.array(A1.default_pose), np.zeros(12), QUAT, np.zeros(3))
    seen = Observer(manifest).observe(measured, None, np.array(A1.default_pose))["state"]
    np.testing.assert_allclose(seen[-9:], np.tile([0.0, -np.sin(0.3), -np.cos(0.3)], 3), atol=1e-6)
    assert dataclasses.replace(config, displacement=True).state_size == 102
