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
