"""That every corridor can be walked from end to end, by chains of obstacles from wall to wall and by flooding."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jp
import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from loco_mjx.scene.passage import closing, opened
from loco_mjx.scene.pool import CHUNK
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import COLLISION_MARGIN, OBSTACLE, WALL, Scene
from tests.quick import OPTIMISED

SCENES = 2000
ROBOT = 0.354  # m wide
CROWDED = ("thin", "random-shape", "forest")
CORRIDORS = (*CROWDED, "wide", "indoor")
SAME = {"thin": ("thin-sphere", "moving", "heightfield"), "wide": ("wide-sphere",)}  # the corridors of another task
NEXT = 14  # obstacles farther on, by x, that an obstacle may be linked to


@cache
def obstacles(task: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Centres and half extents (scenes, N, 2) of boxes around what collides, by x, and how far to each side is free."""

    def draw(key: jax.Array) -> tuple[jax.Array, ...]:
        scene: Scene = TASKS[task].generate(key)
        boxes, trees = scene.boxes, scene.cylinders
        half, cos, sin = boxes.collision_half[:, :2], jp.abs(jp.cos(boxes.yaw)), jp.abs(jp.sin(boxes.yaw))
        around = jp.stack([cos * half[:, 0] + sin * half[:, 1], sin * half[:, 0] + cos * half[:, 1]], axis=1)
        radius = jp.broadcast_to(trees.radius[:, None] + COLLISION_MARGIN, (trees.count, 2))
        join = lambda a, b: jp.concatenate([a[:, :2], b[:, :2]])  # noqa: E731
        kind = jp.concatenate([boxes.kind, jp.full((trees.count,), OBSTACLE)])
        return join(boxes.center, trees.center), join(around, radius), kind

    keys = jax.random.split(jax.random.PRNGKey(8), SCENES)
    options = OPTIMISED if task in CROWDED else None
    scenes = jax.jit(lambda keys: jax.lax.map(draw, keys, batch_size=CHUNK), compiler_options=options)(keys)
    center, half, kind = jax.tree.map(np.asarray, scenes)
    wall = np.flatnonzero(kind[0] == WALL)
    side = float(np.min(np.abs(center[0, wall, 1]) - half[0, wall, 1])) if wall.size else 5.0
    solid = np.setdiff1d(np.arange(center.shape[1]), wall)
    order = solid[np.argsort(center[:, solid, 0], axis=1)][..., None]
    return np.take_along_axis(center, order, 1), np.take_along_axis(half, order, 1), side


def shut(center: np.ndarray, half: np.ndarray, side: float, width: float) -> np.ndarray:
    """(scenes,) whether obstacles less than ``width`` apart join wall to wall: no round robot passes such a chain."""
    scenes, count = center.shape[:2]
    reach = 2.0 * half[..., 0].max() + width
    assert count <= NEXT or (center[:, NEXT:, 0] - center[:, :-NEXT, 0]).min() > reach
    links = []
    for ahead in range(1, min(NEXT, count)):
        apart = np.abs(center[:, ahead:] - center[:, :-ahead]) - half[:, ahead:] - half[:, :-ahead]
        scene, box = np.nonzero(np.sum(np.maximum(apart, 0.0) ** 2, axis=-1) < width**2)
        links.append((scene * (count + 2) + box, scene * (count + 2) + box + ahead))
    for wall, sign in ((count, -1.0), (count + 1, 1.0)):
        scene, box = np.nonzero(side - half[..., 1] - sign * center[..., 1] < width)
        links.append((scene * (count + 2) + box, scene * (count + 2) + wall))
    rows, columns = (np.concatenate(ends) for ends in zip(*links, strict=True))
    nodes = scenes * (count + 2)
    label = connected_components(coo_matrix((np.ones(rows.size), (rows, columns)), (nodes, nodes)), directed=False)[1]
    label = label.reshape(scenes, count + 2)
    return label[:, count] == label[:, count + 1]


def flooded(center: np.ndarray, half: np.ndarray, side: float, width: float, step: float = 0.02) -> bool:
    """Whether a round robot gets from x = 0 past the last obstacle of one scene: every place it fits in, joined up."""
    x = np.arange(0.0, center[:, 0].max() + 2.0, step)[:, None]
    y = np.arange(-side, side, step)[None, :]
    free = np.broadcast_to(np.abs(y) < side - 0.5 * width, (x.size, y.size)).copy()
    for (cx, cy), (hx, hy) in zip(center, half, strict=True):
        rows = slice(max(int((cx - hx - width) / step), 0), int((cx + hx + width) / step) + 2)
        beside, ahead = np.maximum(np.abs(y - cy) - hy, 0.0), np.maximum(np.abs(x[rows] - cx) - hx, 0.0)
        free[rows] &= ahead**2 + beside**2 > (0.5 * width) ** 2
    label, _ = ndimage.label(free)
    return bool(np.intersect1d(label[0][label[0] > 0], label[-1][label[-1] > 0]).size)


@pytest.mark.parametrize("task", CORRIDORS)
def test_a_robot_gets_through_two_thousand_corridors_of_seventy_metres(task):
    center, half, side = obstacles(task)
    assert not shut(center, half, side, ROBOT).any()
    assert (center[..., 0].max(axis=1) > 70.0).all()
    # The density is the same from end to end.
    shares = [((center[..., 0] > low) & (center[..., 0] < low + 21.0)).mean() for low in (4.5, 25.5, 46.5)]
    np.testing.assert_allclose(shares, np.mean(shares), rtol=0.06)


@pytest.mark.parametrize(("of", "task"), [(of, task) for of, tasks in SAME.items() for task in tasks])
def test_other_tasks_have_the_same_corridors(of, task):
    key = jax.random.PRNGKey(4)
    scene, layout = TASKS[task].generate(key), TASKS[of].generate(jax.random.split(key)[0])
    np.testing.assert_array_equal(scene.boxes.center, layout.boxes.center)
    np.testing.assert_array_equal(scene.boxes.half, layout.boxes.half)


def test_flooding_finds_the_same_corridors_open():
    """Some as they are drawn; some with fatter obstacles, a part of which are shut."""
    center, half, side = obstacles("random-shape")
    center, half = center[:10], half[:10]
    compared = []
    for fat in (0.0, 0.16):
        narrow, found, wide = (shut(center, half + fat, side, ROBOT + slack) for slack in (-0.06, 0.0, 0.06))
        for number in np.flatnonzero(narrow == wide):  # a gap may be narrower than the grid can tell
            assert flooded(center[number], half[number] + fat, side, ROBOT) == (not found[number])
            compared.append(bool(found[number]))
    assert compared.count(True) >= 3 and compared.count(False) >= 10


def test_every_row_of_wide_leaves_sixty_centimetres():
    center, half, side = obstacles("wide")
    # By x, a pair, then one block and a pair in turn.
    rows = [np.array([0, 1])] + [np.arange(2 + i // 2 * 3 + i % 2, 3 + i // 2 * 3 + 2 * (i % 2)) for i in range(20)]
    pairs, others = rows[2::2], rows[:1] + rows[1::2]
    assert sorted(np.concatenate(rows)) == list(range(32)) and {row.size for row in pairs} == {2}

    def widest(row: np.ndarray) -> np.ndarray:
        order = np.argsort(center[:, row, 1], axis=1)
        y, reach = (np.take_along_axis(a[:, row, 1], order, axis=1) for a in (center, half))
        edges = np.concatenate([np.full((SCENES, 1), -side), y + reach], axis=1)
        starts = np.concatenate([y - reach, np.full((SCENES, 1), side)], axis=1)
        gap = starts - np.maximum.accumulate(edges, axis=1)
        assert (np.ptp(center[:, row, 0], axis=1) <= 0.2 + 1e-5).all()
        return gap.max(axis=1)

    assert all(widest(row).min() > 0.6 for row in others)
    gaps = np.array([widest(row) for row in pairs])
    # Drawn as they are, one pair in ten would be closer: those are at the limit, and no other has been moved.
    assert gaps.min() > 0.6 - 1e-5 and gaps.max() > 1.6
    assert 0.06 < (gaps < 0.6 + 1e-5).mean() < 0.25


def test_only_what_closes_a_corridor_is_made_smaller():
    """Three boxes from wall to wall, 0.2 m between them; a large one elsewhere."""
    center = jp.array([(5.0, -1.2), (5.0, 0.0), (5.0, 1.2), (9.0, 0.0)])
    half = jp.full((4, 2), 0.45)  # for contact 0.5
    assert closing(center, half + COLLISION_MARGIN, 1.8, 0.354).tolist() == [True, True, True, False]
    assert not closing(center, half + COLLISION_MARGIN, 1.8, 0.19).any()
    wider = np.asarray(opened(center, half, 0.163, 1.8, 0.4))
    np.testing.assert_allclose(wider[:3], 0.163 + (0.45 - 0.163) / 2, rtol=1e-6)  # one step: 0.4 m apart and more
    np.testing.assert_array_equal(wider[3], half[3])
    # Alone, whichever wall it touches, a box closes nothing; nor do two of them.
    assert not closing(center[:2], half[:2] + COLLISION_MARGIN, 1.8, 0.354).any()
    np.testing.assert_array_equal(opened(center[1:], half[1:], 0.163, 1.8, 0.4), half[1:])


def test_a_corridor_that_the_smallest_boxes_close_is_given_up():
    center = jp.array([(5.0, -0.5), (5.0, 0.0), (5.0, 0.5)])
    half = np.asarray(opened(center, jp.full((3, 2), 0.5), 0.163, 0.8, 0.4))
    assert (half >= 0.163).all() and (half < 0.17).all()
