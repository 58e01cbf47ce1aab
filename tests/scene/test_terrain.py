from __future__ import annotations

import jax
import numpy as np
import pytest

from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import Terrain
from tests.scene.scenes import pool


def axes(terrain: Terrain) -> tuple[np.ndarray, np.ndarray]:
    nx, ny = terrain.heights.shape[1:]
    x, y = (terrain.origin[i] + terrain.cell * np.arange(n) for i, n in ((0, nx), (1, ny)))
    return x[:, None], y[None, :]


def slopes(terrain: Terrain) -> np.ndarray:
    """Steepness of every cell but the last of each axis."""
    rise_x = np.diff(terrain.heights, axis=1)[:, :, :-1]
    rise_y = np.diff(terrain.heights, axis=2)[:, :-1]
    return np.hypot(rise_x, rise_y) / terrain.cell


def on_the_way(terrain: Terrain) -> np.ndarray:
    """Cells between the start and the summit."""
    x, y = axes(terrain)
    return ((x > 2.5) & (x < 11.0) & (np.abs(y) < 3.5))[:-1, :-1]


@pytest.mark.parametrize("task", ["mountain", "heightfield", "forest", "hill"])
def test_level_around_the_start(task):
    terrain = pool(task).terrain
    x, y = axes(terrain)
    start = np.maximum(np.abs(x), np.abs(y)) < 1.1
    assert np.abs(terrain.heights[:, start]).max() < 1e-6
    level = np.hypot(x, y) < 1.3  # a start at ±1 m, and the feet 0.2 m ahead
    assert np.abs(terrain.heights[:, level]).max() < 0.01
    assert start.sum() > 300


@pytest.mark.parametrize(("task", "low", "high"), [("mountain", 2.3, 2.7), ("hill", 1.2, 1.6)])
def test_summit(task, low, high):
    scenes = pool(task)
    goal = scenes.goal
    np.testing.assert_allclose(np.hypot(goal[:, 0], goal[:, 1]), 11.0, rtol=1e-5)
    assert low <= goal[:, 2].min() and goal[:, 2].max() <= high and np.ptp(goal[:, 2]) > 0.5 * (high - low)
    assert 0.25 < np.abs(np.arctan2(goal[:, 1], goal[:, 0])).max() <= 0.3 + 1e-5
    at_goal, _, _ = jax.jit(jax.vmap(ground))(scenes.terrain, goal[:, 0], goal[:, 1])
    np.testing.assert_allclose(at_goal, goal[:, 2], atol=0.1)
    assert (scenes.terrain.heights.max(axis=(1, 2)) <= goal[:, 2] + 1e-5).all()  # nothing is higher
    np.testing.assert_array_equal(scenes.spheres.center[:, 0], goal)
    np.testing.assert_allclose(scenes.spheres.radius, 0.8)
    assert not scenes.spheres.reward.any()


def test_the_mountain_is_rugged_and_can_be_climbed():
    terrain = pool("mountain").terrain
    steepness = slopes(terrain)[:, on_the_way(terrain)]
    assert 0.2 < np.median(steepness) < 0.5
    assert (steepness < 0.6).mean() > 0.75 and (steepness > 0.9).mean() > 0.02
    step = np.abs(np.diff(terrain.heights, axis=1))[:, :, :-1][:, on_the_way(terrain)]
    assert np.quantile(step, 0.95) < 0.1  # m between neighbouring vertices
    bend = np.diff(terrain.heights, n=2, axis=1)[:, :, :-1][:, on_the_way(terrain)[:-1]]
    assert np.std(bend) > 0.01  # rough at the scale of a foot


def test_the_straight_line_up_the_mountain_is_hard():
    scenes = pool("mountain")
    along = np.linspace(0.0, 1.0, 300, dtype=np.float32)
    line = along[None, :, None] * scenes.goal[:, None, :2]
    height = np.asarray(jax.jit(jax.vmap(ground))(scenes.terrain, line[..., 0], line[..., 1])[0])
    steepest = np.abs(np.diff(height, axis=1)).max(axis=1) / (11.0 / 299)
    assert (steepest > 0.7).mean() > 0.9
    climbed = np.maximum(np.diff(height, axis=1), 0).sum(axis=1)
    assert np.median(climbed - scenes.goal[:, 2]) > 0.3  # it goes down again on the way


def test_uneven_ground_is_blocks_of_up_to_five_centimetres():
    terrain = pool("heightfield").terrain
    heights = terrain.heights
    assert terrain.cell == 0.12 and heights.min() == 0.0 and 0.0499 < heights.max() <= 0.05
    blocks = heights[:, ::2, ::2]
    for part in (heights[:, 1::2, ::2], heights[:, ::2, 1::2], heights[:, 1::2, 1::2]):
        np.testing.assert_array_equal(part, blocks)
    x, y = axes(terrain)
    rest = blocks[:, (np.maximum(np.abs(x), np.abs(y)) > 1.7)[::2, ::2]]
    assert abs((rest == 0.0).mean() - 0.5) < 0.01
    np.testing.assert_allclose(
        np.histogram(rest[rest > 0], bins=5, range=(0, 0.05))[0] / (rest > 0).sum(), 0.2, atol=0.01
    )
    assert y[0, -1] > 3.4 and y[0, 0] < -3.4
    walls = pool("heightfield").boxes
    middle, half = walls.center[0, -1, 0], walls.half[0, -1, 0]
    assert x[0] <= middle - half and x[-1] >= middle + half  # as far as the walls


def test_the_forest_floor_has_slopes_and_potholes():
    terrain = pool("forest").terrain
    x, _ = axes(terrain)
    far = terrain.heights[:, x[:, 0] > 4.0]
    grade = np.polyfit(x[x > 4.0], far.mean(axis=2).T, 1)[0]
    assert 0.05 < np.abs(grade).max() < 0.2 and (grade > 0).any() and (grade < 0).any()
    around = (np.roll(far, 2, 1) + np.roll(far, -2, 1) + np.roll(far, 2, 2) + np.roll(far, -2, 2)) / 4
    depth = (around - far)[:, 2:-2, 2:-2]
    assert (depth > 0.06).mean() > 2 * (depth < -0.06).mean() and depth.max() < 0.2


def test_hills_are_smooth():
    terrain = pool("hill").terrain
    assert np.quantile(slopes(terrain)[:, on_the_way(terrain)], 0.99) < 0.8
