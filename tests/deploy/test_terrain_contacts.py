"""A sphere deep in a heightfield has one contact, with the plane beneath it; C's own push it sideways."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loco_mjx.deploy.terrain_contacts import TerrainContacts, plane

RADIUS, SLOPE = 0.02, 0.5
GROUND = """<mujoco><option timestep='0.0025'/><asset><hfield name='h' nrow='11' ncol='21' size='1 0.5 1 0.2'/></asset>
<worldbody>{more}<geom name='ground' type='hfield' hfield='h' pos='0.3 0.1 -0.2' condim='3'/>
<body name='ball' pos='{place}'><freejoint/><geom type='sphere' size='0.02' mass='0.1'/></body></worldbody></mujoco>"""


def ground(place: str, more: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A slope that rises along x, its surface at z = SLOPE · (x + 0.7) − 0.2, and a ball at a place."""
    model = mujoco.MjModel.from_xml_string(GROUND.format(place=place, more=more))
    model.hfield_data[:] = np.tile(np.linspace(0, 2 * SLOPE, 21), 11)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("x", [0.301, 0.355, 0.398])  # near the sides of prisms, and between them
def test_a_deep_sphere_is_pushed_along_the_normal(x):
    normal = np.array([-SLOPE, 0.0, 1.0]) / np.hypot(1.0, SLOPE)
    surface = np.array([x, 0.149, SLOPE * (x + 0.7) - 0.2])
    model, data = ground(" ".join(str(value) for value in surface - 0.007 * normal))  # the centre is 7 mm below
    mujoco.mj_forward(model, data)
    sideways = [c for c in data.contact if abs(c.frame[2]) < 0.5]
    assert sideways  # what this is about
    contacts = TerrainContacts(model)
    assert contacts.flatten(data)
    (one,) = [c for c in data.contact if not c.exclude]
    np.testing.assert_allclose(one.frame[:3], normal, atol=1e-6)
    assert one.dist == pytest.approx(-0.027, abs=1e-6)
    np.testing.assert_allclose(np.reshape(one.frame, (3, 3)) @ np.reshape(one.frame, (3, 3)).T, np.eye(3), atol=1e-9)
    for _ in range(4):
        contacts.step(data)
    push = data.qvel[:3] / np.linalg.norm(data.qvel[:3])
    assert push @ normal > 0.99


def test_elsewhere_it_is_mj_step():
    """In the air, on a box that stands on the heightfield, and without any heightfield."""
    box = "<geom type='box' size='0.1 0.1 0.1' pos='0.3 0.1 0.4' />"
    for place, more in (("0.3 0.1 0.9", ""), ("0.3 0.1 0.519", box)):
        model, data = ground(place, more)
        other = mujoco.MjData(model)
        for _ in range(20):
            TerrainContacts(model).step(data)
            mujoco.mj_step(model, other)
        np.testing.assert_array_equal(data.qpos, other.qpos)
    flat = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 0.01'><freejoint/><geom size='0.02'/>"
        "</body></worldbody></mujoco>"
    )
    data, other = mujoco.MjData(flat), mujoco.MjData(flat)
    TerrainContacts(flat).step(data)
    mujoco.mj_step(flat, other)
    np.testing.assert_array_equal(data.qpos, other.qpos)


def test_the_plane_is_where_cs_rays_hit():
    model, data = ground("0 0 5")
    random = np.random.default_rng(0)
    model.hfield_data[:] = random.uniform(0, 1, model.hfield_data.size)
    mujoco.mj_forward(model, data)
    points = random.uniform([-0.7, -0.4, 2.0], [1.3, 0.6, 2.0], (200, 3))
    geom = model.geom("ground").id
    height, normal = plane(model, geom, points)
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    rays = [mujoco.mj_ray(model, data, point, down, None, 1, 1, hit) for point in points]
    np.testing.assert_allclose(points[:, 2] - rays, height, atol=1e-6)
    along = points + np.array([1e-4, 0.0, 0.0])  # a step on the surface is at right angles to the normal
    rise = np.stack([np.full(200, 1e-4), np.zeros(200), plane(model, geom, along)[0] - height], axis=1)
    assert np.median(np.abs(np.sum(rise * normal, axis=1))) < 1e-9
