"""Images of heightfields: planes worked out by hand, and a slow march along every ray."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.depth import camera
from loco_mjx.depth.render import render
from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import Terrain
from tests.depth.test_render import at, make_scene
from tests.known_robots import A1

CONFIG = DepthConfig()
see = jax.jit(partial(render, mount=A1.camera, config=CONFIG))
SHAPE, ORIGIN, CELL = (150, 140), (-2.0, -7.0), 0.1
X = ORIGIN[0] + CELL * np.arange(SHAPE[0])[:, None]
Y = ORIGIN[1] + CELL * np.arange(SHAPE[1])[None, :]


def terrain_scene(heights: np.ndarray) -> object:
    return make_scene(terrain=Terrain(jp.asarray(np.broadcast_to(heights, SHAPE), jp.float32), ORIGIN, CELL))


def about(axis: int, angle: float) -> tuple[float, ...]:
    """Quaternion of a rotation about x, y or z."""
    return (np.cos(angle / 2), *(np.sin(angle / 2) if axis == i else 0.0 for i in range(3)))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [-0.4, -0.1, 0.0, 0.3, 0.9])
def test_level_terrain_is_the_plane(axis: int, angle: float) -> None:
    """As far as the grid reaches; and beyond it nothing is seen."""
    pose = at(0, 0, 0.4, about(axis, angle))
    plane = np.asarray(see(make_scene(), pose.at[2].add(-0.1)))
    image = np.asarray(see(terrain_scene(np.full(SHAPE, 0.1)), pose))
    origin, rotation = camera.pose(pose, A1.camera)
    hit = np.asarray(origin)[:, None] + np.asarray(rotation) @ (plane.ravel() * [np.ones(4096), *camera.rays(CONFIG)])
    x, y = hit[0].reshape(64, 64), hit[1].reshape(64, 64)
    inside = (x > -1.9) & (x < 12.8) & (np.abs(y) < 6.8) & (plane < 9.9)
    outside = (x > 13.0) | (np.abs(y) > 7.0)
    assert inside.sum() > 200
    np.testing.assert_allclose(image[inside], plane[inside], atol=2e-3)
    assert (image[outside] == 10.0).all()


def test_slope_of_a_known_grade() -> None:
    """Uphill by 0.3: a level ray from 0.6 m above the slope at the camera hits it 2 m ahead."""
    image = np.asarray(see(terrain_scene(0.3 * X), at(0, 0, 0.6)))
    up = camera.rays(CONFIG)[1].reshape(64, 64)
    np.testing.assert_allclose(image[20:], (0.6 / (0.3 - up))[20:], rtol=1e-3)
    np.testing.assert_allclose(image[[31, 32], 10], [0.6 / 0.290979, 0.6 / 0.309021], rtol=1e-3)


def test_wall_of_one_cell() -> None:
    """A step of 2 m between two vertices hides what is behind it."""
    image = np.asarray(see(terrain_scene(np.where(X > 4.95, 2.0, 0.0)), at(0, 0, 0.5)))
    # The face rises from (4.9, 0) to (5.0, 2).
    up = camera.rays(CONFIG)[1].reshape(64, 64)
    # 2 m high at 5 m is 0.3 up: row 15 (0.577350 · 33/64 = 0.297696) hits, row 14 misses.
    face = (4.9 + 0.05 * 0.5) / (1 - 0.05 * up)
    np.testing.assert_allclose(image[16:37, 16:48], face[16:37, 16:48], atol=0.05)
    assert (image[:15] == 10.0).all()


def test_shapes_stand_before_terrain() -> None:
    scene = terrain_scene(np.zeros(SHAPE)).replace(boxes=make_scene(boxes=[(2.5, 0, 0.5, 0.5, 0.5, 5, 0)]).boxes)
    image = np.asarray(see(scene, at(0, 0, 0.5)))
    np.testing.assert_allclose(image[31, 31], 2.0, atol=1e-5)
    np.testing.assert_allclose(image[63, 31], 0.879772, atol=1e-3)


def march(terrain: Terrain, pose: jax.Array, step: float = 0.004) -> np.ndarray:
    """Depth where each ray first is below the surface, by 4 mm steps along the optical axis."""
    origin, rotation = (np.asarray(part) for part in camera.pose(pose, A1.camera))
    direction = rotation @ np.stack([np.ones(4096), *camera.rays(CONFIG)])
    height = jax.jit(lambda x, y: ground(terrain, x, y)[0])
    depth, found = np.full(4096, CONFIG.far), np.zeros(4096, bool)
    for t in np.arange(0.0, CONFIG.far, step):
        x, y, z = origin[:, None] + t * direction
        nx, ny = terrain.heights.shape
        inside = (x >= ORIGIN[0]) & (y >= ORIGIN[1]) & (x <= X[nx - 1, 0]) & (y <= Y[0, ny - 1])
        below = inside & (z < np.asarray(height(x, y)))
        depth = np.where(below & ~found, t - step / 2, depth)
        found |= below
    return np.clip(depth, CONFIG.near, CONFIG.far).reshape(64, 64)


def test_rugged_terrain_against_a_slow_march() -> None:
    rng = np.random.default_rng(0)
    heights = 0.15 * np.sin(1.3 * X) * np.cos(0.9 * Y) + 0.02 * rng.normal(size=SHAPE) + 0.08 * X
    for _ in range(40):
        i, j = rng.integers(25, 140), rng.integers(5, 135)
        heights[i : i + 3, j : j + 3] += rng.uniform(0.1, 0.4)
    scene = terrain_scene(heights)
    for tilt in (-0.1, 0.15):
        pose = at(0, 0.3, 0.5, about(1, tilt))
        expected, image = march(scene.terrain, pose), np.asarray(see(scene, pose))
        # Along silhouettes, which are everywhere here, either side may be read.
        assert (np.abs(image - expected) > 0.05).mean() < 0.05
        assert np.median(np.abs(image - expected)) < 0.005


@pytest.mark.parametrize("ahead", [0.03, 0.07])
def test_a_thin_wall_right_ahead_hides_all(ahead: float) -> None:
    """A ridge one vertex wide, higher than the camera, its crest nearer than a cell."""
    image = np.asarray(see(terrain_scene(np.where(np.abs(X - 0.2) < 0.01, 0.45, 0.0)), at(0.2 - ahead, 0, 0.4)))
    assert (image[32:] == CONFIG.near).all()


def test_the_edge_of_the_grid_is_where_it_is() -> None:
    """Looking back at the grid from beyond its edge: the wall beneath its border, as C MuJoCo has it."""
    end = float(X[-1, 0])
    for away in (0.5, 1.23, 2.7):
        image = np.asarray(see(terrain_scene(np.full(SHAPE, 2.0)), at(end + away, 0, 0.5, about(2, np.pi))))
        np.testing.assert_allclose(image[20:, 8:56], away, atol=5e-3)


def test_spikes_of_one_cell() -> None:
    """Needles of 0.6 m: 98 of 100 pixels within 5 cm of a slow march. What is missed are needles' tips and sides."""
    rng = np.random.default_rng(1)
    wrong = []
    for height in (0.35, 0.5):
        heights = np.zeros(SHAPE)
        heights[rng.integers(28, 140, 60), rng.integers(5, 135, 60)] = 0.6
        scene, pose = terrain_scene(heights), at(0, 0.3, height)
        wrong.append(np.abs(march(scene.terrain, pose) - np.asarray(see(scene, pose))) > 0.05)
    assert np.mean(wrong) < 0.02
