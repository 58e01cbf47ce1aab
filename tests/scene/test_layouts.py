from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from loco_mjx.errors import UnknownNameError
from loco_mjx.scene.parts import scatter
from loco_mjx.scene.surface import ground, ground_height
from loco_mjx.scene.tasks import TASKS, get_task
from loco_mjx.scene.types import COLLISION_MARGIN, OBSTACLE, STEP, WALL
from tests.refusals import refusal
from tests.scene.scenes import SIZE, one, pool

# obstacles, walls, steps, spheres, cylinders, heightfield
CONTENT = {
    "thin": (135, 2, 0, 0, 0, False),
    "wide": (32, 2, 0, 0, 0, False),
    "thin-sphere": (135, 2, 0, 127, 0, False),
    "wide-sphere": (32, 2, 0, 127, 0, False),
    "moving": (135, 2, 0, 0, 0, False),
    "mountain": (0, 0, 0, 1, 0, True),
    "heightfield": (135, 2, 0, 0, 0, True),
    "random-shape": (135, 2, 0, 0, 0, False),
    "indoor": (39, 2, 0, 0, 0, False),
    "forest": (0, 0, 0, 0, 135, True),
    "hill": (0, 0, 0, 1, 0, True),
    "stairs": (0, 0, 4, 0, 0, False),
}


def distances(points: np.ndarray) -> np.ndarray:
    """Of all pairs of different points, per layout."""
    return np.stack([pdist(layout) for layout in points])


def test_the_registry_names_every_task_in_order():
    assert list(TASKS) == list(CONTENT)
    assert all(get_task(name).name == name for name in CONTENT)
    assert {name for name, task in TASKS.items() if task.toward_goal} == {"mountain", "hill"}
    assert {name for name, task in TASKS.items() if task.moving} == {"moving"}
    with refusal("task montain mountain", UnknownNameError):
        get_task("montain")


@pytest.mark.parametrize("task", CONTENT)
def test_content(task):
    scenes = pool(task)
    *counts, field = CONTENT[task]
    kinds = scenes.boxes.kind
    found = [np.unique((kinds == kind).sum(axis=1)) for kind in (OBSTACLE, WALL, STEP)]
    assert [list(f) for f in found] == [[count] for count in counts[:3]]
    assert (scenes.spheres.count, scenes.cylinders.count) == tuple(counts[3:])
    assert (scenes.terrain is not None) == field
    assert not scenes.spheres.collected.any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(scenes))
    assert (scenes.boxes.half > 0).all() and (np.any(scenes.goal != 0) == TASKS[task].toward_goal)


@pytest.mark.parametrize("task", CONTENT)
def test_every_scene_is_another_one(task):
    scenes = pool(task)
    flat = np.concatenate([np.reshape(leaf, (SIZE, -1)).astype(np.float64) for leaf in jax.tree.leaves(scenes)], axis=1)
    assert len(np.unique(flat, axis=0)) == SIZE


@pytest.mark.parametrize("task", CONTENT)
def test_the_start_is_clear(task):
    """Nothing to touch where a robot of 0.35 m half length may start, x ± 1 m."""
    scenes = pool(task)
    solid = scenes.boxes.kind != WALL
    reach = np.hypot(*np.moveaxis(scenes.boxes.collision_half[..., :2], -1, 0))
    turned = scenes.boxes.yaw != 0
    reach = np.where(turned, reach, scenes.boxes.collision_half[..., 0])
    near = np.where(solid, scenes.boxes.center[..., 0] - reach, np.inf)
    trees = scenes.cylinders.center[..., 0] - scenes.cylinders.radius - COLLISION_MARGIN
    assert near.min(initial=np.inf) > 1.4 and trees.min(initial=np.inf) > 1.4


def test_thin_keeps_its_centres_a_metre_apart_for_every_key():
    centers = pool("thin", 2048).boxes.center[:, :135]
    assert distances(centers[..., :2]).min() >= 1.0 - 1e-6
    assert centers[..., 0].min() >= 2.5 and centers[..., 0].max() <= 73.0
    assert np.abs(centers[..., 1]).max() <= 3.0
    np.testing.assert_allclose(centers[..., 2], 0.7)


def test_thin_is_uniform_over_the_area():
    x, y = np.moveaxis(pool("thin", 2048).boxes.center[:, :135, :2], -1, 0)
    for value, low, high in ((x, 2.5, 73.0), (y, -3.0, 3.0)):
        share = np.histogram(value, bins=4, range=(low, high))[0] / value.size
        # Every share is 1/4 but for the rim, where a centre keeps others off on one side only: more fit there.
        np.testing.assert_allclose(share, 0.25, atol=0.03)
        assert value.min() < low + 0.01 and value.max() > high - 0.01


def test_thin_sizes_and_walls():
    boxes = one("thin").boxes
    np.testing.assert_allclose(boxes.half[:135], np.tile([0.18, 0.18, 0.7], (135, 1)))
    np.testing.assert_allclose(boxes.collision_half[:135], np.tile([0.23, 0.23, 0.7], (135, 1)))
    np.testing.assert_allclose(boxes.center[135:], [[36, -3.1, 2.1], [36, 3.1, 2.1]])
    np.testing.assert_allclose(boxes.half[135:], [[48, 0.106, 2.1]] * 2)
    assert not boxes.yaw.any() and not boxes.velocity.any()


def test_scatter_finds_room_where_there_is_hardly_any():
    """10 points a metre apart in 6 m × 4.8 m: nine discs cover at most 98 % of it."""
    keys = jax.random.split(jax.random.PRNGKey(0), 64)
    points = np.asarray(jax.jit(jax.vmap(lambda key: scatter(key, 10, (0.0, 0.0), (6.0, 4.8), 1.0)))(keys))
    assert distances(points).min() >= 1.0 - 1e-6 and points.min() >= 0 and points.max() <= 6.0


def test_scatter_refuses_what_may_not_fit():
    with refusal("11 fit", ValueError):
        scatter(jax.random.PRNGKey(0), 11, (0.0, 0.0), (6.0, 4.8), 1.0)


def test_wide_is_the_pattern_with_jitter():
    boxes = pool("wide").boxes
    pattern = [(3, -0.75), (3, 0.75)] + [(6 + 7 * i, 0) for i in range(10)]
    pattern += [(9 + 7 * i, y) for i in range(10) for y in (-1.3, 1.3)]
    jitter = boxes.center[:, :32, :2] - np.array(pattern)
    assert 0.09 < np.abs(jitter[..., 0]).max() <= 0.1 + 1e-5
    sideways = np.abs(jitter[..., 1])
    assert 0.35 < sideways[:, :12].max() <= 0.4 + 1e-5
    # Pairs that would close their row stand farther apart: of 0.1 m that jitter may leave, 0.5 m more.
    assert sideways[:, 12:].max() <= 0.65 + 1e-5 and (sideways[:, 12:] > 0.4 + 1e-5).mean() < 0.2
    np.testing.assert_allclose(boxes.half[0, :32], [[0.25, 0.4, 0.5]] * 2 + [[0.25, 0.8, 0.5]] * 30)
    np.testing.assert_allclose(np.abs(boxes.center[:, 32:, 1]), 2.3)


@pytest.mark.parametrize("task", ["thin-sphere", "wide-sphere"])
def test_spheres(task):
    spheres = pool(task).spheres
    np.testing.assert_allclose(spheres.radius, 0.2)
    np.testing.assert_allclose(spheres.center[..., 2], 0.2)
    x, y = spheres.center[..., 0], np.abs(spheres.center[..., 1])
    assert 2.0 <= x.min() < 2.2 and 72.8 < x.max() <= 73.0 and 2.1 < y.max() <= 2.2
    assert spheres.reward.all()
    # Spheres and obstacles are drawn apart: another sphere does not mean another obstacle in the same place.
    assert np.abs(np.corrcoef(spheres.center[:, 0, 0], pool(task).boxes.center[:, 0, 0])[0, 1]) < 0.5


def test_random_shape_sizes():
    boxes = pool("random-shape").boxes
    half = boxes.half[:, :135]
    assert 0.163 <= half[..., :2].min() < 0.17 and 0.51 < half[..., :2].max() <= 0.52
    assert 0.45 <= half[..., 2].min() < 0.46 and 0.94 < half[..., 2].max() <= 0.95
    np.testing.assert_allclose(boxes.center[:, :135, 2], half[..., 2])
    assert distances(boxes.center[:, :135, :2]).min() >= 1.0 - 1e-6


def test_a_robot_fits_past_every_carton_indoors():
    boxes = pool("indoor").boxes
    half, yaw = boxes.collision_half[:, :39], boxes.yaw[:, :39]
    reach_x = half[..., 0] * np.cos(yaw) + half[..., 1] * np.abs(np.sin(yaw))
    reach_y = half[..., 0] * np.abs(np.sin(yaw)) + half[..., 1] * np.cos(yaw)
    face = boxes.center[0, 40, 1] - boxes.collision_half[0, 40, 1]
    beside = face + np.abs(boxes.center[:, :39, 1]) - reach_y
    assert beside.min() > 0.7
    x = boxes.center[:, :39, 0]
    assert (x[:, 1:] - reach_x[:, 1:] - x[:, :-1] - reach_x[:, :-1]).min() > 0.3
    assert np.abs(yaw).max() > 0.4


def test_trees_stand_in_the_ground():
    scenes = pool("forest")
    center, half = scenes.cylinders.center, scenes.cylinders.half_height
    assert distances(center[..., :2]).min() >= 1.2 - 1e-6
    root, _, _ = jax.jit(jax.vmap(ground))(scenes.terrain, center[..., 0], center[..., 1])
    np.testing.assert_allclose(center[..., 2] - half, root - 0.4, atol=1e-5)


def test_stairs_rise_and_fall_by_ten_centimetres():
    scene = one("stairs")
    x = np.linspace(0.0, 10.0, 1001, dtype=np.float32)
    height = np.asarray(jax.jit(jax.vmap(lambda x: ground_height(scene, x, np.float32(0.3))))(x))
    steps = np.diff(height)
    rises = steps[np.abs(steps) > 1e-6]
    np.testing.assert_allclose(rises, [0.1] * 4 + [-0.1] * 4, atol=1e-6)
    edges = x[1:][np.abs(steps) > 1e-6]
    assert np.diff(edges)[:3].min() > 0.38 and np.diff(edges)[:3].max() < 0.5 and 3.4 < edges[4] - edges[3] < 4.6
    assert height[0] == 0.0 == height[-1]
