"""Closed-form kinematics against C MuJoCo's, and by hand."""

from __future__ import annotations

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.physics.kinematics import pose, sphere_centers
from loco_mjx.robots import LEGS
from tests.known_robots import A1
from tests.physics.world import standing

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo


def _random_poses(count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    quat = rng.normal(size=(count, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    angles = rng.uniform(A1.lower, A1.upper, (count, 12))
    return np.concatenate([rng.normal(size=(count, 3)), quat, angles], axis=1)


def test_centers_are_mujocos():
    model = mujoco.MjModel.from_xml_path(str(A1.path))
    data = mujoco.MjData(model)
    poses = _random_poses(20)
    ours = np.stack(jax.jit(jax.vmap(lambda qpos: sphere_centers(A1, qpos)))(poses.astype(np.float32)), axis=-1)
    for qpos, centers in zip(poses, ours, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(centers, [data.geom(name).xpos for name in A1.spheres], atol=2e-6)


def test_anchors_and_axes_are_mujocos():
    model = mujoco.MjModel.from_xml_path(str(A1.path))
    data = mujoco.MjData(model)
    data.qpos[:] = _random_poses(1)[0]
    mujoco.mj_forward(model, data)
    robot = pose(A1, data.qpos.astype(np.float32))
    anchors = {"hip": robot.hip, "thigh": robot.shoulder, "calf": robot.knee}
    for leg, name in enumerate(LEGS):
        for part, anchor in anchors.items():
            joint = data.joint(f"{name}_{part}_joint")
            np.testing.assert_allclose([axis[leg] for axis in anchor], joint.xanchor, atol=1e-6)
            expected = robot.forward if part == "hip" else [axis[leg] for axis in robot.side]
            np.testing.assert_allclose(expected, joint.xaxis, atol=1e-6)


def test_environments_may_be_on_the_last_axis():
    poses = _random_poses(5).astype(np.float32)
    centers = jax.jit(lambda qpos: jp.stack(sphere_centers(A1, qpos)))
    one_by_one = np.array([centers(qpos) for qpos in poses])
    np.testing.assert_allclose(np.moveaxis(centers(poses.T), -1, 0), one_by_one, atol=1e-6)


def test_feet_of_the_default_pose_by_hand():
    x, y, z = sphere_centers(A1, standing(height=0.5))
    # A thigh leaning back by 0.9 rad and a calf leaning forward by 0.9 rad: the foot is below the shoulder.
    np.testing.assert_allclose(x[:4], [0.183, 0.183, -0.183, -0.183], atol=1e-6)
    np.testing.assert_allclose(y[:4], [-0.13205, 0.13205, -0.13205, 0.13205], atol=1e-6)
    np.testing.assert_allclose(z[:4], 0.5 - 0.4 * np.cos(0.9), atol=1e-6)
