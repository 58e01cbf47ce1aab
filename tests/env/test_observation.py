"""The parts of the observation by hand-computed numbers."""

import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx import rotations
from loco_mjx.config import ObservationConfig
from loco_mjx.env import observation
from loco_mjx.sensors import Readings
from tests.known_robots import A1


def _quaternion(roll=0.0, pitch=0.0, yaw=0.0):
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, (yaw, pitch, roll), "zyx")
    return jp.array(quat, jp.float32)


@pytest.mark.parametrize("yaw", [0.0, 1.3])
def test_roll_and_pitch_do_not_depend_on_yaw(yaw):
    angles = rotations.roll_pitch(_quaternion(0.2, -0.3, yaw))
    np.testing.assert_allclose(angles, [0.2, -0.3], atol=1e-6)


@pytest.mark.parametrize(("latency", "expected"), [(0.0, 16.0), (0.0025, 15.0), (0.00375, 14.5), (0.04, 0.0)])
def test_latency_interpolates_between_physics_steps(latency, expected):
    trace = jp.arange(A1.substeps + 1.0)[:, None]
    assert observation.delayed(trace, jp.array(latency), A1.physics_dt)[0] == pytest.approx(expected, abs=1e-4)


def test_state_is_grouped_by_sensor_newest_first():
    config = ObservationConfig()
    history = observation.first_history(config, A1)
    for step in (1.0, 2.0, 3.0):
        # the trunk turned about x by step / 10 rad: its roll
        quat = jp.array([jp.cos(step / 20), jp.sin(step / 20), 0.0, 0.0])
        now = Readings(quat, jp.full(3, 10 + step), jp.full(12, 30 + step), jp.full(12, 20 + step), jp.full(3, step))
        history = observation.push(history, now)
    vector = np.array(observation.state_vector(history, None))
    assert vector.shape == (93,) == (config.state_size,)
    expected = [np.repeat([base + 3.0, base + 2, base + 1], size) for base, size in ((0, 3), (20, 12), (30, 12))]
    imu = np.array([[0.1 * step, 0.0, 10 + step, 10 + step] for step in (3, 2, 1)]).ravel()
    np.testing.assert_allclose(vector, np.concatenate([expected[0], imu, *expected[1:]]), atol=1e-6)


def test_real_preset_has_84_values_and_no_displacement():
    config = ObservationConfig(displacement=False)
    assert observation.state_vector(observation.first_history(config, A1), None).shape == (84,) == (config.state_size,)


def test_first_history_is_three_copies_of_the_standing_robot():
    history = observation.first_history(ObservationConfig(), A1)
    np.testing.assert_allclose(history["angles"], np.tile([0, 0.9, -1.8], (3, 4)), atol=1e-6)
    assert not history["imu"].any() and not history["displacement"].any() and not history["last_action"].any()


def test_frames_are_newest_first_and_copied_at_the_start():
    stack = jp.zeros((2, 2, 4))
    stack = observation.push_frame(stack, jp.full((2, 2), 1.0), jp.array(True))
    assert (stack == 1.0).all()
    stack = observation.push_frame(stack, jp.full((2, 2), 2.0), jp.array(False))
    np.testing.assert_array_equal(stack[0, 0], [2.0, 1.0, 1.0, 1.0])


def test_goal_is_seen_in_the_bases_heading():
    qpos = jp.concatenate([jp.array([1.0, 2.0, 0.3]), _quaternion(yaw=np.pi / 2), jp.zeros(12)])
    relative = observation.goal_in_base(jp.array([1.0, 5.0, 0.8]), qpos)
    np.testing.assert_allclose(relative, [3.0, 0.0, 0.5], atol=1e-6)  # 3 m to the north, straight ahead
