"""The ground against C MuJoCo's heightfield: its rays and its contacts, on random heights."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest

from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import Terrain

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

SHAPE, CELL, ORIGIN = (9, 6), 0.5, (-1.0, 2.0)
RADIUS = 0.01


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    heights = np.random.default_rng(0).uniform(-0.2, 0.3, SHAPE).astype(np.float32)
    return Terrain(heights, ORIGIN, CELL)


@pytest.fixture(scope="module")
def model(terrain: Terrain) -> mujoco.MjModel:
    """Written out apart from loco_mjx/scene/mjcf.py: rows are y, columns are x, data are scaled to 0…1."""
    (nx, ny), lowest, span = SHAPE, terrain.heights.min(), np.ptp(terrain.heights)
    half_x, half_y = CELL * (nx - 1) / 2, CELL * (ny - 1) / 2
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <asset><hfield name="h" nrow="{ny}" ncol="{nx}" size="{half_x} {half_y} {span} 0.1"/></asset>
      <worldbody>
        <geom type="hfield" hfield="h" pos="{ORIGIN[0] + half_x} {ORIGIN[1] + half_y} {lowest}"/>
        <body name="ball"><freejoint/><geom name="ball" size="{RADIUS}" mass="1" group="1"/></body>
      </worldbody></mujoco>""")
    model.hfield_data[:] = ((terrain.heights - lowest) / span).T.ravel()
    return model


def points(count: int, clear_of_edges: float) -> np.ndarray:
    """Random points over the grid, some share of a cell away from every edge of a triangle."""
    rng = np.random.default_rng(1)
    inside = rng.uniform(0, 1, (20 * count, 2))
    u, v = inside.T
    gap = np.min([u, v, 1 - u, 1 - v, np.abs(u - v)], axis=0)
    inside = inside[gap > clear_of_edges][:count]
    cell = rng.integers(0, np.array(SHAPE) - 1, inside.shape)
    return (np.array(ORIGIN) + CELL * (cell + inside)).astype(np.float32)


def test_height_is_what_mj_ray_hits(terrain, model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    xy, hit, down = points(500, 1e-4), np.zeros(1, np.int32), np.array([0.0, 0.0, -1.0])
    groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    seen = [2 - mujoco.mj_ray(model, data, np.array([x, y, 2.0]), down, groups, 1, -1, hit) for x, y in xy]
    height, _, _ = jax.jit(ground)(terrain, *xy.T)
    np.testing.assert_allclose(height, seen, atol=1e-5)


def test_contacts_lie_on_the_same_triangles(terrain, model):
    data = mujoco.MjData(model)
    xy = points(100, 0.1)
    height, slope_x, slope_y = (np.asarray(value, np.float64) for value in ground(terrain, *xy.T))
    normals = np.stack([-slope_x, -slope_y, np.ones_like(height)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for (x, y), z, normal in zip(xy, height, normals, strict=True):
        data.qpos[:3] = np.array([x, y, z]) + 0.9 * RADIUS * normal
        mujoco.mj_forward(model, data)
        assert data.ncon
        deepest = min(data.contact, key=lambda contact: contact.dist)
        assert deepest.dist == pytest.approx(-0.1 * RADIUS, abs=2e-5)
        assert abs(deepest.frame[:3] @ normal) == pytest.approx(1.0, abs=1e-3)
