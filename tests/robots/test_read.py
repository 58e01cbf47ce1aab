"""What is read of a robot's MJCF: the figures that were published, what MuJoCo makes of it, and what does not fit."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loco_mjx.physics.compiled import compiled
from loco_mjx.robots import LEGS, PARTS, get_robot, joint_names, register_robot
from loco_mjx.robots.registry import ROBOTS as NAMED
from tests.known_robots import A1, GO1, GO2, ROBOTS
from tests.refusals import refusal

# Masses of trunk, hip, thigh and calf, kg; centres of mass of the left front leg's, m; principal inertias, kg m².
PUBLISHED = {
    GO1: {
        "mass": (5.204, 0.68, 1.009, 0.195862),
        "hip": (-0.0049166, -0.00762615, -8.865e-05),
        "thigh": (-0.00304722, -0.019315, -0.0305004),
        "calf": (0.00429862, 0.000976676, -0.146197),
        "inertia": ((7.34064e-4, 4.68438e-4, 3.98719e-4), (4.78717e-3, 4.60903e-3, 7.09268e-4)),
    },
    GO2: {
        "mass": (6.921, 0.678, 1.152, 0.241352),
        "hip": (-0.0054, 0.00194, -0.000105),
        "thigh": (-0.00374, -0.0223, -0.0327),
        "calf": (0.00629595, -0.000622121, -0.141417),
        "inertia": ((8.8403e-4, 5.96003e-4, 4.79967e-4), (5.94973e-3, 5.84149e-3, 8.78787e-4)),
    },
}
IDS = [robot.name for robot in ROBOTS]


def _inertia(model: mujoco.MjModel, name: str) -> np.ndarray:
    """(3, 3) about the centre of mass, in the body's axes."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body(name).iquat)
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(model.body(name).inertia) @ rotation.T


@pytest.mark.parametrize("robot", PUBLISHED, ids=IDS[1:])
def test_masses_and_inertias_are_the_published_ones(robot):
    model, figures = compiled(robot)[1], PUBLISHED[robot]
    assert model.body("trunk").mass[0] == figures["mass"][0]
    for part, mass in zip(PARTS, figures["mass"][1:], strict=True):
        assert all(model.body(f"{leg}_{part}").mass[0] == mass for leg in LEGS)
        np.testing.assert_allclose(model.body(f"FL_{part}").ipos, figures[part])
    for part, inertia in zip(PARTS, figures["inertia"], strict=False):
        np.testing.assert_allclose(model.body(f"RL_{part}").inertia, inertia, rtol=1e-6)
    # Right legs mirror left ones, rear hips the front ones: a quaternion of another leg would show.
    mirror_y, mirror_x = np.diag([1, -1, 1]), np.diag([-1, 1, 1])
    for part in ("hip", "thigh"):
        right, left = _inertia(model, f"FR_{part}"), _inertia(model, f"FL_{part}")
        np.testing.assert_allclose(mirror_y @ right @ mirror_y, left, atol=2e-7)
    front, rear = _inertia(model, "FL_hip"), _inertia(model, "RL_hip")
    np.testing.assert_allclose(mirror_x @ front @ mirror_x, rear, atol=2e-7)
    assert model.body("RR_hip").ipos[0] == -model.body("FR_hip").ipos[0]


@pytest.mark.parametrize("robot", ROBOTS, ids=IDS)
def test_what_is_read_is_what_mujoco_compiles(robot):
    model = compiled(robot)[1]
    np.testing.assert_array_equal(model.jnt_range[1:].T, [robot.lower, robot.upper])
    np.testing.assert_array_equal(model.actuator_ctrlrange[:, 1], robot.torque_limit)
    np.testing.assert_array_equal(model.key("stand").qpos, [0, 0, robot.stand_height, 1, 0, 0, 0, *robot.default_pose])
    np.testing.assert_allclose([model.geom(name).size[0] for name in robot.spheres], robot.radii)
    np.testing.assert_allclose(model.camera("depth_camera").pos, robot.camera)
    np.testing.assert_allclose(model.site("imu").pos, robot.imu)
    assert [model.joint(i + 1).name for i in range(12)] == list(joint_names())
    assert (robot.control_dt, robot.substeps) == (0.04, 16)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose([data.geom(name).xpos[2] for name in robot.spheres[:4]], robot.radii[0], atol=1e-4)


def test_the_robots_differ_where_they_should():
    assert GO2.lower[1::3] == (-1.5708, -1.5708, -0.5236, -0.5236) and GO2.upper[1::3] == (
        3.4907,
        3.4907,
        4.5379,
        4.5379,
    )
    assert GO1.torque_limit == (23.7, 23.7, 35.55) * 4 and A1.torque_limit == (33.5,) * 12
    assert (GO1.kp, GO1.kd, A1.kp, A1.kd) == (35.0, 0.5, 40.0, 0.6)
    assert GO2.foot == (-0.002, -0.213) and GO2.camera == (0.28, 0.0, 0.03)


# An own robot ------------------------------------------------------------------------------------------------------


@pytest.fixture
def own(tmp_path):
    """Writes an MJCF that differs from the Go2's in some words."""

    def write(*changes: tuple[str, str]) -> str:
        text = GO2.path.read_text().replace('model="go2"', 'model="mine"')
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        path = tmp_path / "mine.xml"
        path.write_text(text)
        return str(path)

    return write


def test_an_own_robot_is_read_from_its_path(own):
    mine = get_robot(own(('armature="0.01"', 'armature="0.01" damping="0.3"'), ('data="40"', 'data="33"')))
    assert (mine.name, mine.kp, mine.damping) == ("mine", 33.0, (0.3,) * 12)
    assert mine.hips == GO2.hips and hash(mine) == hash(get_robot(str(mine.path)))
    np.testing.assert_array_equal(compiled(mine)[1].dof_damping[6:], mine.damping)


def test_angles_in_degrees_are_understood(own):
    path = own(('angle="radian" ', ""), ('range="-1.0472 1.0472"', 'range="-60 60"'))
    np.testing.assert_allclose(get_robot(path).upper[::3], np.pi / 3)


UNFIT = {
    "no trunk": (('<body name="trunk"', '<body name="torso"'), "body trunk"),
    "no joint": (('<joint name="RL_calf_joint"', '<joint name="RL_knee"'), "joint RL_calf_joint"),
    "no sphere": (('name="FL_foot_sphere"', 'name="FL_toe"'), "geom FL_foot_sphere"),
    "no sphere on the trunk": (('name="trunk_', 'name="belly_'), "trunk geom trunk_…_sphere"),
    "no camera": (('<camera name="depth_camera"', '<camera name="eye"'), "camera depth_camera"),
    "no IMU": (('<site name="imu"', '<site name="sensor"'), "site imu"),
    "no pose": (('<key name="stand"', '<key name="rest"'), "key stand"),
    "no gains": (('<numeric name="kd"', '<numeric name="damping"'), "numeric kd"),
    "no freejoint": (('<freejoint name="base"/>', ""), "trunk freejoint"),
    "another axis": (('<joint axis="1 0 0"', '<joint axis="0 0 1"'), "hinge (1.0, 0.0, 0.0)"),
    "no limits": (('<joint range="-2.7227 -0.83776"/>', ""), "FR_calf_joint range"),
    "dry friction": (('armature="0.01"', 'armature="0.01" frictionloss="0.2"'), "frictionloss 0.2 0"),
    "servos": (("<motor name=", "<position name="), "actuators <motor>"),
    "unlike feet": (('name="FL_foot_sphere" class="foot"', 'name="FL_foot_sphere" class="foot" size="0.03"'), "radii"),
    "a knee elsewhere": (('name="RR_knee_sphere"', 'name="RR_knee_sphere" pos="0 0 0.1"'), "RR_knee_sphere calf"),
    "a camera that looks down": (
        ('pos="0.28 0 0.03" xyaxes="0 -1 0 0 0 1"', 'pos="0.28 0 0.03"'),
        "depth_camera ahead",
    ),
    "a rate": (('name="policy_hz" data="25"', 'name="policy_hz" data="30"'), "policy_hz 30"),
    "no XML": (("</mujoco>", ""), "line"),
}


@pytest.mark.parametrize(("change", "said"), UNFIT.values(), ids=UNFIT.keys())
def test_what_is_missing_is_said_in_one_line(change, said, own):
    path = own(change)
    with refusal(f"{said} {path} docs/robots.md") as caught:
        get_robot(path)
    text = str(caught.value)
    assert "\n" not in text, text


ASSUMED = {
    "a collision geom of its own": (
        ('<geom class="sole"/>', '<geom type="sphere" size="0.01"/>'),
        "collide contype 0",
    ),
    "looks that its own camera sees": (
        ('<geom class="sole"/>', '<geom type="sphere" size="0.01" contype="0" conaffinity="0" group="2"/>'),
        "group 2 1",
    ),
    "no friction under a foot": (('-0.213" condim="3"', '-0.213" condim="1"'), "FR_foot_sphere condim"),
    "two kinds of contact": (('size="0.025" condim="3"', 'size="0.025" condim="3" solref="0.01 1"'), "solref"),
    "another cone": (('cone="pyramidal"', 'cone="elliptic"'), "<option> pyramidal"),
}


@pytest.mark.parametrize(("change", "said"), ASSUMED.values(), ids=ASSUMED.keys())
def test_what_physics_assumes_is_compared(change, said, own):
    with refusal(said) as caught:
        compiled(get_robot(own(change)))
    assert "\n" not in str(caught.value)


def test_names():
    with refusal("robot go3 a1 go1 go2"):
        get_robot("go3")
    with refusal("none/of/this.xml a1 go1 go2 path"):
        get_robot("none/of/this.xml")


def test_a_robot_may_be_given_a_name(own):
    path = own()
    try:
        assert register_robot("mine", path) == get_robot("mine")
        with refusal("robot a1 already"):
            register_robot("a1", path)
    finally:
        NAMED.unregister("mine")
