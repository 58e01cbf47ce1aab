"""The robots beside the A1 against C MuJoCo: where their spheres are, how they trot, what their cameras see."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import DepthConfig, PhysicsConfig
from loco_mjx.depth import c_mujoco
from loco_mjx.depth.render import render
from loco_mjx.physics.kinematics import sphere_centers
from loco_mjx.physics.model import build
from loco_mjx.physics.step import control_step, initial_state, nominal_dynamics
from loco_mjx.robots import Robot
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.parts import make_boxes, make_scene
from tests.known_robots import GO1, GO2
from tests.physics.world import GAIT_KD, GAIT_KP, c_rollout, flat_c_model, trot_targets

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

STEPS = 20
GO = pytest.mark.parametrize("robot", (GO1, GO2), ids=("go1", "go2"))


@GO
def test_spheres_are_where_mujoco_has_them(robot):
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data, rng = mujoco.MjData(model), np.random.default_rng(2)
    quat = rng.normal(size=4)
    data.qpos[:] = np.concatenate(
        [rng.normal(size=3), quat / np.linalg.norm(quat), rng.uniform(robot.lower, robot.upper)]
    )
    mujoco.mj_kinematics(model, data)
    ours = np.stack(sphere_centers(robot, jp.asarray(data.qpos, jp.float32)), axis=1)
    np.testing.assert_allclose(ours, [data.geom(name).xpos for name in robot.spheres], atol=2e-6)


def _trotted(robot: Robot, targets: np.ndarray) -> np.ndarray:
    """(STEPS, 19) configurations after each control step of ours on flat ground."""
    model = build(robot, PhysicsConfig())
    step = jax.jit(functools.partial(control_step, model))
    state, how = initial_state(_standing(robot)), nominal_dynamics(GAIT_KP, GAIT_KD)
    trace = []
    for target in targets:
        state, _ = step(state, make_scene(), jp.asarray(target), how)
        trace.append(np.asarray(state.qpos))
    return np.array(trace)


def _standing(robot: Robot) -> np.ndarray:
    return np.array([0.0, 0.0, robot.stand_height, 1.0, 0.0, 0.0, 0.0, *robot.default_pose], np.float32)


@GO
def test_a_trot_is_c_mujocos(robot):
    targets = trot_targets(STEPS, robot)
    theirs = c_rollout(flat_c_model(robot), _standing(robot), targets, GAIT_KP, GAIT_KD)
    ours = _trotted(robot, targets)
    assert np.linalg.norm(ours[:, :3] - theirs[:, :3], axis=1).max() < 1e-4
    assert np.ptp(theirs[:, 2]) > 0.05  # it does trot


def test_depth_is_seen_from_the_robots_own_camera():
    """The Go2's is above its trunk's origin, so that a trunk that pitches moves it ahead and back."""
    config = DepthConfig(height=16, width=16)
    scene = make_scene(make_boxes(jp.array([[2.0, 0.4, 0.3]]), jp.array([0.1, 0.3, 0.3])))
    model = scene_spec(jax.tree.map(np.asarray, scene), GO2).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pose = np.array([0.3, 0.1, 0.35, 0.98, 0.05, 0.12, 0.15], np.float32)
    seen = jax.jit(render, static_argnums=(2, 3))(scene, jp.asarray(pose), GO2.camera, config)
    np.testing.assert_allclose(seen, c_mujoco.cast(model, data, pose, GO2.camera, config), atol=2e-3)
    data.qpos[:7] = pose / np.concatenate([np.ones(3), np.full(4, np.linalg.norm(pose[3:]))])
    mujoco.mj_forward(model, data)
    rotation = data.body("trunk").xmat.reshape(3, 3)
    np.testing.assert_allclose(
        data.camera("depth_camera").xpos, data.body("trunk").xpos + rotation @ GO2.camera, atol=1e-6
    )
