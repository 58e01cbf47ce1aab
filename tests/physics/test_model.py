"""mjcf/a1.xml against the published figures."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.model import build
from loco_mjx.robots import LEGS, PARTS, joint_names
from tests.known_robots import A1
from tests.refusals import refusal

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

MASS = {"trunk": 4.713, "hip": 0.696, "thigh": 1.013, "calf": 0.226}
PRINCIPAL = {
    "hip": (0.000807752, 0.00055293, 0.000468983),
    "thigh": (0.00555739, 0.00513936, 0.00133944),
    "calf": (0.00340344, 0.00339393, 3.54834e-05),
}


@pytest.fixture(scope="module")
def robot() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(A1.path))


def _inertia(model: mujoco.MjModel, name: str) -> np.ndarray:
    """(3, 3) inertia about the centre of mass, in the body's axes."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body(name).iquat)
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(model.body(name).inertia) @ rotation.T


def test_size_and_mass(robot):
    assert (robot.nbody - 1, robot.nq, robot.nv, robot.nu) == (13, 19, 18, 12)
    assert robot.body_mass.sum() == pytest.approx(12.453, abs=1e-6)
    assert robot.opt.timestep == A1.physics_dt
    np.testing.assert_allclose(robot.opt.gravity, [0, 0, -9.81])


def test_order_limits_and_motors(robot):
    assert [robot.joint(i + 1).name for i in range(12)] == list(joint_names())
    assert [robot.actuator(i).trnid[0] for i in range(12)] == list(range(1, 13))
    np.testing.assert_allclose(robot.jnt_range[1:, 0], A1.lower)
    np.testing.assert_allclose(robot.jnt_range[1:, 1], A1.upper)
    np.testing.assert_allclose(robot.actuator_ctrlrange, [[-33.5, 33.5]] * 12)
    np.testing.assert_allclose(robot.actuator_gear[:, 0], 1.0)
    np.testing.assert_allclose(robot.dof_armature[6:], 0.01)
    assert not robot.dof_damping.any() and not robot.dof_frictionloss.any()


def test_trunk_inertia(robot):
    expected = np.array([
        [0.0158533, -3.66e-05, -6.11e-05],
        [-3.66e-05, 0.0377999, -2.75e-05],
        [-6.11e-05, -2.75e-05, 0.0456542],
    ])  # fmt: skip
    np.testing.assert_allclose(_inertia(robot, "trunk"), expected, atol=1e-8)
    np.testing.assert_allclose(robot.body("trunk").ipos, [0, 0.0041, -0.0005])
    assert robot.body("trunk").mass[0] == MASS["trunk"]


@pytest.mark.parametrize("leg", LEGS)
def test_links(robot, leg):
    front, left = (1 if leg[0] == "F" else -1), (1 if leg[1] == "L" else -1)
    com = {
        "hip": (-front * 0.003311, left * 0.000635, 3.1e-05),
        "thigh": (-0.003237, -left * 0.022327, -0.027326),
        "calf": (0.00472659, 0.0, -0.131975),
    }
    pos = {"hip": (front * 0.183, left * 0.047, 0), "thigh": (0, left * 0.08505, 0), "calf": (0, 0, -0.2)}
    for part in PARTS:
        body = robot.body(f"{leg}_{part}")
        assert body.mass[0] == MASS[part]
        np.testing.assert_allclose(body.ipos, com[part])
        np.testing.assert_allclose(body.pos, pos[part])
        np.testing.assert_allclose(body.inertia, PRINCIPAL[part], rtol=1e-6)


def test_legs_mirror_each_other(robot):
    mirror_y, mirror_x = np.diag([1, -1, 1]), np.diag([-1, 1, 1])
    for part in PARTS:
        right, left = _inertia(robot, f"FR_{part}"), _inertia(robot, f"FL_{part}")
        np.testing.assert_allclose(mirror_y @ right @ mirror_y, left, atol=2e-8)
    front, rear = _inertia(robot, "FL_hip"), _inertia(robot, "RL_hip")
    np.testing.assert_allclose(mirror_x @ front @ mirror_x, rear, atol=2e-8)
    np.testing.assert_allclose(_inertia(robot, "FL_thigh"), _inertia(robot, "RL_thigh"), atol=1e-9)


def test_spheres_collide_with_scenes_only(robot):
    spheres = {robot.geom(name).id for name in A1.spheres}
    colliding = set(np.flatnonzero(robot.geom_contype | robot.geom_conaffinity))
    assert colliding == spheres
    assert {int(robot.geom_type[g]) for g in spheres} == {int(mujoco.mjtGeom.mjGEOM_SPHERE)}
    np.testing.assert_allclose([robot.geom(name).size[0] for name in A1.spheres], A1.radii)
    assert not any(robot.geom_contype[a] & robot.geom_conaffinity[b] for a in spheres for b in spheres)
    assert {robot.geom_group[g] for g in spheres} == {4}
    assert set(robot.geom_group) - {4} == {1}


def test_depth_camera_looks_ahead(robot):
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, robot.key("stand").id)
    mujoco.mj_forward(robot, data)
    camera, site = data.camera("depth_camera"), data.site("depth_camera")
    np.testing.assert_allclose(camera.xpos, [0.2309, 0, A1.stand_height])
    np.testing.assert_allclose(site.xpos, camera.xpos)
    # A camera's own axes: x right, y up, it looks along −z.
    np.testing.assert_allclose(camera.xmat.reshape(3, 3).T, [[0, -1, 0], [0, 0, 1], [-1, 0, 0]], atol=1e-12)
    assert robot.camera("depth_camera").fovy[0] == 60.0


def test_stands_on_the_ground_at_stand_height(robot):
    data = mujoco.MjData(robot)
    mujoco.mj_resetDataKeyframe(robot, data, robot.key("stand").id)
    mujoco.mj_forward(robot, data)
    lowest = [data.geom(name).xpos[2] - A1.leg_radii[0] for name in A1.spheres[:4]]
    np.testing.assert_allclose(lowest, 0.0, atol=1e-4)


@pytest.mark.parametrize(
    ("config", "slots", "name"),
    [
        (PhysicsConfig(iterations=0), 1, "physics.iterations"),
        (PhysicsConfig(ls_iterations=0), 1, "physics.ls_iterations"),
        (PhysicsConfig(more_iterations=-1), 1, "physics.more_iterations"),
        (PhysicsConfig(), 0, "obstacle_slots"),
    ],
)
def test_senseless_sizes_are_refused_by_name(config, slots, name):
    with refusal(name):
        build(A1, config, slots)
