from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.scene.parts import make_boxes, make_scene
from loco_mjx.scene.query import collect, first_obstacle_x
from loco_mjx.scene.types import OBSTACLE, STEP, WALL, Cylinders, Spheres
from tests.scene.scenes import one


def four_spheres():
    center = jp.array([[1.0, 0.0, 0.2], [1.0, 0.19, 0.2], [1.0, -0.21, 0.2], [1.0, 0.0, 0.9]])
    return make_scene(
        spheres=Spheres(center, jp.full((4,), 0.2), jp.zeros((4,), bool), jp.array([True, True, True, False]))
    )


def test_spheres_within_twenty_centimetres_are_collected_once():
    here = jp.array([1.0, 0.0])
    first, count = jax.jit(collect)(four_spheres(), here)
    assert int(count) == 2 and count.dtype == jp.int32
    np.testing.assert_array_equal(first.spheres.collected, [True, True, False, False])
    again, none = collect(first, here)
    assert int(none) == 0
    more, third = collect(again, jp.array([1.0, -0.2]))
    assert int(third) == 1
    np.testing.assert_array_equal(more.spheres.collected, [True, True, True, False])


def test_the_goals_marker_is_never_collected():
    scene = one("mountain")
    after, count = collect(scene, scene.goal[:2])
    assert int(count) == 0 and not after.spheres.collected.any()


def test_nothing_to_collect():
    scene, count = collect(one("thin"), jp.zeros(2))
    assert int(count) == 0 and scene.spheres.count == 0


def test_first_obstacle_is_neither_wall_nor_step():
    boxes = make_boxes(jp.array([[1.0, 0, 0], [2.0, 0, 0], [5.0, 0, 0], [4.0, 0, 0]]), jp.ones(3))
    boxes = boxes.replace(kind=jp.array([WALL, STEP, OBSTACLE, OBSTACLE], jp.int32))
    trees = Cylinders(jp.array([[3.5, 1.0, 0.0], [9.0, 0.0, 0.0]]), jp.ones(2), jp.ones(2))
    assert float(first_obstacle_x(make_scene(boxes))) == 4.0
    assert float(first_obstacle_x(make_scene(boxes, cylinders=trees))) == 3.5
    for task in ("mountain", "stairs"):
        assert float(first_obstacle_x(one(task))) == np.inf
    assert 2.5 <= float(first_obstacle_x(one("thin"))) < 6.0
