"""The triangles that the browser draws lie where C MuJoCo's geoms are."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loco_mjx.show import meshes

XML = """<mujoco>
<asset><hfield name="h" nrow="4" ncol="6" size="3 1 0.5 0.1"/></asset>
<worldbody>
<geom name="hfield" type="hfield" hfield="h" pos="1 2 0.3"/>
<geom name="box" type="box" size="0.2 0.3 0.1" pos="10 0 0.3" euler="0 0 30"/>
<geom name="cylinder" type="cylinder" size="0.3 0.2" pos="20 0 0.2"/>
<geom name="sphere" type="sphere" size="0.3" pos="30 0 0.5"/>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def world():
    model = mujoco.MjModel.from_xml_string(XML)
    model.hfield_data[:] = np.random.default_rng(0).uniform(size=24)  # no symmetry that hides a swapped axis
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize(("name", "tolerance"), [("hfield", 1e-6), ("box", 1e-6), ("cylinder", 1e-6), ("sphere", 0.02)])
def test_a_ray_from_above_meets_the_triangles_where_it_meets_the_geom(world, name, tolerance):
    model, data = world
    geom = model.geom(name).id
    mesh = meshes.mesh(model, geom)
    reach = 0.9 * np.array([3.0, 1.0]) if name == "hfield" else np.array([0.15, 0.15])
    places = data.geom_xpos[geom][:2] + np.random.default_rng(1).uniform(-reach, reach, (200, 2))
    starts = np.column_stack([places, np.full(200, 5.0)])
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    expected = [5.0 - mujoco.mj_ray(model, data, start, down, None, 1, -1, hit) for start in starts]
    found, ray, _ = mesh.ray.intersects_location(starts, np.tile(down, (200, 1)), multiple_hits=True)
    highest = [found[ray == i, 2].max() for i in range(200)]
    np.testing.assert_allclose(highest, expected, atol=tolerance)


def test_the_floor_is_one_checker_wherever_the_robot_is():
    """Each place has the same colour from every patch that covers it, neighbours differ, and the robot stands on it."""

    def colour(robot, place):
        for _, mesh, paint in meshes.floor():
            low, high = mesh.vertices[mesh.faces].min(1), mesh.vertices[mesh.faces].max(1)
            local = np.append(place, 0.0) - meshes.floor_place(robot)
            if np.any(np.all((low <= local) & (local <= high), axis=1)):
                return paint
        return None

    rng = np.random.default_rng(0)
    for _ in range(20):
        place = np.round(rng.uniform(-100, 100, 2)) + 0.3
        robots = [np.append(place + rng.uniform(-15, 15, 2), 0.3) for _ in range(2)]
        first, second = (colour(robot, place) for robot in robots)
        assert first == second is not None
        assert colour(robots[0], place + np.array([meshes.TILE, 0])) != first == colour(robots[0], place + meshes.TILE)


def test_only_an_endless_plane_that_is_seen_makes_a_floor():
    def model(geom):
        return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geom}</worldbody></mujoco>")

    seen = model('<geom type="plane" size="0 0 1" group="2"/>')
    assert meshes.has_floor(seen) and not meshes.by_body(seen, set())
    assert not meshes.has_floor(model('<geom type="plane" size="0 0 1" group="3"/>'))
    assert not meshes.has_floor(model('<geom type="box" size="1 1 1" group="2"/>'))
