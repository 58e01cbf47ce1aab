"""Legs and masses against C MuJoCo, of every robot."""

import mujoco
import numpy as np
import pytest

from loco_mjx.robots import LEGS, get_robot
from loco_mjx.robots.read import read
from loco_mjx.whole_body import legs
from loco_mjx.whole_body.masses import masses
from tests.refusals import refusal


@pytest.fixture(params=["a1", "go1", "go2"])
def robot(request):
    return get_robot(request.param)


def poses(robot, count=20):
    """Joint angles in the middle half of their ranges."""
    low, high = np.array(robot.lower), np.array(robot.upper)
    return np.random.default_rng(0).uniform(low + 0.25 * (high - low), high - 0.25 * (high - low), (count, 12))


def put(robot, angles):
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)
    data.qpos[:7], data.qpos[7:] = (0, 0, 0, 1, 0, 0, 0), angles
    mujoco.mj_forward(model, data)
    return model, data


def test_feet_are_where_mujoco_has_them(robot):
    body = legs.body_of(robot)
    for angles in poses(robot):
        _, data = put(robot, angles)
        there = [data.geom(f"{leg}_foot_sphere").xpos for leg in LEGS]
        np.testing.assert_allclose(legs.feet(body, angles), there, atol=1e-12)


def test_jacobians_are_mujocos(robot):
    body = legs.body_of(robot)
    for angles in poses(robot, 5):
        model, data = put(robot, angles)
        jacobians = legs.jacobians(body, angles)
        for leg, name in enumerate(LEGS):
            full = np.zeros((3, model.nv))
            mujoco.mj_jacGeom(model, data, full, None, model.geom(f"{name}_foot_sphere").id)
            np.testing.assert_allclose(jacobians[leg], full[:, 6 + 3 * leg : 9 + 3 * leg], atol=1e-12)


def test_angles_put_feet_back(robot):
    """Of the poses whose feet are below their hips: feet above them would have the legs folded over the trunk."""
    body, random = legs.body_of(robot), np.random.default_rng(1)
    for _ in range(50):
        angles = np.array(robot.default_pose) + random.uniform(-1, 1, 12) * np.tile([0.6, 0.6, 0.7], 4)
        where = legs.feet(body, angles)
        np.testing.assert_allclose(legs.angles_for(body, where), angles, atol=1e-9)


def test_out_of_reach_is_as_near_as_the_limits_allow(robot):
    body = legs.body_of(robot)
    for where in (np.full((4, 3), 3.0), body.hips.copy(), np.full((4, 3), [0.0, 0.0, -5.0])):
        found = legs.angles_for(body, where)
        assert np.all(np.isfinite(found)) and np.all(found >= body.lower) and np.all(found <= body.upper)


def test_masses_are_mujocos(robot):
    model, data = put(robot, robot.default_pose)
    mass = model.body_mass.sum()
    center = model.body_mass @ data.xipos / mass
    inertia = np.zeros((3, 3))
    for turn, place, diagonal, one in zip(data.ximat, data.xipos, model.body_inertia, model.body_mass, strict=True):
        turn, r = turn.reshape(3, 3), place - center
        inertia += turn @ np.diag(diagonal) @ turn.T + one * (r @ r * np.eye(3) - np.outer(r, r))
    found = masses(robot)
    assert found.mass == pytest.approx(mass)
    np.testing.assert_allclose(found.center, center, atol=1e-9)
    np.testing.assert_allclose(found.inertia, inertia, atol=1e-6)


def test_a_link_without_inertia_is_named(tmp_path):
    text = get_robot("a1").path.read_text()
    start = text.index('<inertial mass="4.713"')
    path = tmp_path / "a1.xml"
    path.write_text(text[:start] + text[text.index("/>", start) + 2 :])
    with refusal("trunk"):
        legs.body_of(read(path))
