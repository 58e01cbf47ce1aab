"""Tangent planes and the choice of what is near, by hand."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics import shapes
from loco_mjx.physics.collision import ContactSlots, broadphase, narrowphase
from loco_mjx.physics.kinematics import centers, pose
from loco_mjx.physics.shapes import Box, Cylinder
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import OBSTACLE, STEP, WALL, Scene, Terrain
from tests.known_robots import A1
from tests.physics.world import scene, standing

CORNER = 1 / np.sqrt(3)

_near = jax.jit(lambda world, qpos, config: broadphase(world, A1, qpos, config), static_argnums=2)
box_distance, box_plane = jax.jit(shapes.box_distance), jax.jit(shapes.box_plane)
cylinder_distance, cylinder_plane = jax.jit(shapes.cylinder_distance), jax.jit(shapes.cylinder_plane)
ground_plane = jax.jit(shapes.ground_plane)


def _point(*values: float) -> tuple[jax.Array, ...]:
    return tuple(jp.float32(v) for v in values)


def _box(yaw: float = 0.0) -> Box:
    """Half extents 1, 2, 3 about (10, 20, 30)."""
    turn = jp.array([np.cos(yaw), np.sin(yaw)], jp.float32)
    return Box(jp.array([10.0, 20.0, 30.0]), jp.array([1.0, 2.0, 3.0]), turn)


@pytest.mark.parametrize(
    ("offset", "distance", "normal"),
    [
        ((1.5, 0.5, -1.0), 0.5, (1, 0, 0)),  # beyond a face
        ((-1.5, 0.5, -1.0), 0.5, (-1, 0, 0)),
        ((0.0, 0.0, 3.25), 0.25, (0, 0, 1)),
        ((1.3, 2.4, 0.0), 0.5, (0.6, 0.8, 0)),  # beyond an edge
        ((1.1, -2.1, -3.1), 0.1 * np.sqrt(3), (CORNER, -CORNER, -CORNER)),  # beyond a corner
        ((0.8, 0.5, 1.0), -0.2, (1, 0, 0)),  # inside: the nearest face
        ((0.2, -1.9, 1.0), -0.1, (0, -1, 0)),
        ((0.2, 0.5, 2.95), -0.05, (0, 0, 1)),
        ((1.0, 0.5, 0.0), 0.0, (1, 0, 0)),  # on a face
        ((1.0, 2.0, 3.0), 0.0, (1, 0, 0)),  # on a corner: some face
    ],
)
def test_box(offset, distance, normal):
    point = _point(10 + offset[0], 20 + offset[1], 30 + offset[2])
    plane = box_plane(point, _box())
    np.testing.assert_allclose(plane.distance, distance, atol=1e-5)
    np.testing.assert_allclose(plane.normal, normal, atol=2e-5)
    np.testing.assert_allclose(box_distance(point, _box()), distance, atol=1e-5)


def test_turned_box():
    # Turned by +90°, its x axis points along the world's y.
    plane = box_plane(_point(10.0, 21.5, 30.0), _box(np.pi / 2))
    np.testing.assert_allclose(plane.distance, 0.5, atol=1e-5)
    np.testing.assert_allclose(plane.normal, (0, 1, 0), atol=1e-5)
    # Turned by 45°, straight along x lies the edge between +x and −y, √(1 + …) away: check by the rotated offset.
    inward = box_plane(_point(10 + 1.5 * np.cos(0.7), 20 + 1.5 * np.sin(0.7), 30.0), _box(0.7))
    np.testing.assert_allclose(inward.distance, 0.5, atol=1e-5)
    np.testing.assert_allclose(inward.normal, (np.cos(0.7), np.sin(0.7), 0), atol=1e-5)


@pytest.mark.parametrize(
    ("offset", "distance", "normal"),
    [
        ((3.0, 4.0, 0.5), 4.0, (0.6, 0.8, 0)),  # beside it
        ((0.3, 0.4, 2.5), 0.5, (0, 0, 1)),  # above it
        ((0.3, 0.4, -2.5), 0.5, (0, 0, -1)),
        ((1.3, 0.0, 2.4), 0.5, (0.6, 0, 0.8)),  # beyond the rim
        ((0.54, 0.72, 0.0), -0.1, (0.6, 0.8, 0)),  # inside, near the side
        ((0.1, 0.0, 1.9), -0.1, (0, 0, 1)),  # inside, near the cap
        ((0.0, 0.0, 0.0), -1.0, (1, 0, 0)),  # on the axis: some direction
    ],
)
def test_cylinder(offset, distance, normal):
    cylinder = Cylinder(jp.array([5.0, 6.0, 7.0]), jp.float32(1.0), jp.float32(2.0))
    point = _point(5 + offset[0], 6 + offset[1], 7 + offset[2])
    plane = cylinder_plane(point, cylinder)
    np.testing.assert_allclose(plane.distance, distance, atol=1e-5)
    np.testing.assert_allclose(plane.normal, normal, atol=2e-5)
    np.testing.assert_allclose(cylinder_distance(point, cylinder), distance, atol=1e-5)


def test_ground_is_the_plane_of_the_triangle_beneath():
    heights = jp.array([[0.0, 0.0], [0.3, 0.3]])  # rises 0.3 m over 1 m of x
    terrain = Terrain(heights, (0.0, 0.0), 1.0)
    plane = ground_plane(terrain, _point(0.5, 0.5, 1.15))
    slope = np.hypot(1.0, 0.3)
    np.testing.assert_allclose(plane.distance, 1.0 / slope, rtol=1e-6)
    np.testing.assert_allclose(plane.normal, (-0.3 / slope, 0, 1 / slope), atol=1e-6)
    flat = ground_plane(None, _point(0.5, 0.5, 1.15))
    np.testing.assert_allclose((flat.distance, *flat.normal), (1.15, 0, 0, 1), atol=1e-6)


def test_near_keeps_the_boxes_whose_surfaces_are_nearest():
    long = {"center": (0.0, 3.0, 0.0), "half": (30.0, 0.1, 1.0), "kind": WALL}  # centre far, side near: 2.85 m
    small = [{"center": (x, 0.0, 0.0), "half": (0.1, 0.1, 1.0), "kind": OBSTACLE} for x in (29.0, 33.5, 40.0)]
    world = scene([long, *small], [{"center": (30.0, 1.0, 0.0), "radius": 0.2, "half_height": 1.0}])
    picked = _near(world, jp.asarray(standing(30.0)), PhysicsConfig(near_boxes=2, near_cylinders=5))
    np.testing.assert_allclose(picked.boxes.center[:, 0], [29.0, 0.0])
    # Obstacles' contact boxes are 5 cm larger per side in x and y.
    np.testing.assert_allclose(picked.boxes.half[0], [0.15, 0.15, 1.0], rtol=1e-6)
    np.testing.assert_allclose(picked.cylinders.radius, [0.25], rtol=1e-6)
    assert picked.solid.tolist() == [True, True]


def test_near_is_what_is_near_a_foot_not_what_is_near_the_trunk():
    """Blocks under the belly are nearer to the trunk than the stones are that the feet stand on."""
    stones = [{"center": (x, y, 0.05), "half": (0.05, 0.05, 0.05)} for x in (-0.183, 0.183) for y in (-0.13, 0.13)]
    blocks = [{"center": (x, 0.0, 0.1), "half": (0.04, 0.04, 0.1)} for x in (-0.05, 0.0, 0.05)]
    robot = jp.asarray(standing(height=0.1 + A1.stand_height))
    all_of_them = _near(scene([*blocks, *stones]), robot, PhysicsConfig())
    assert all_of_them.dropped == 0
    assert np.sum(np.abs(all_of_them.boxes.center[:, 0]) < 1.0) == 7
    four = _near(scene([*blocks, *stones]), robot, PhysicsConfig(near_boxes=4))
    np.testing.assert_allclose(np.abs(four.boxes.center[:, 0]), 0.183, rtol=1e-6)


def test_what_is_left_out_within_reach_is_counted():
    ring = [
        {"center": (0.4 * np.cos(a), 0.4 * np.sin(a), 0.3), "half": (0.05, 0.05, 0.3)} for a in np.arange(0, 6, 0.6)
    ]
    trees = [{"center": (x, 0.0, 0.3), "radius": 0.05, "half_height": 0.3} for x in (-0.2, -0.1, 0.1, 0.2, 9.0)]
    robot, far = jp.asarray(standing()), jp.asarray(standing(x=5.0))
    within = [int(_near(scene([box], trees[4:]), robot, PhysicsConfig(near_boxes=0)).dropped) for box in ring]
    assert 3 < sum(within) < len(ring)
    counted = _near(scene(ring, trees), robot, PhysicsConfig(near_boxes=3, near_cylinders=2)).dropped
    assert counted == sum(within) - 3 + 2
    assert _near(scene(ring, trees), robot, PhysicsConfig(near_boxes=10, near_cylinders=4)).dropped == 0
    assert _near(scene(ring, trees), far, PhysicsConfig(near_boxes=1, near_cylinders=1)).dropped == 0


@pytest.mark.parametrize("task", ["wide", "moving", "heightfield", "random-shape", "indoor", "forest", "stairs"])
def test_no_task_has_more_near_the_robot_than_is_felt(task):
    def left_out(key):
        scene_key, x_key, y_key, yaw_key = jax.random.split(key, 4)
        world = TASKS[task].generate(scene_key)
        # x ~ U(−1, 72) m, y ~ U(−2, 2) m, yaw ~ U(−π, π), standing on the ground
        x, y = (jax.random.uniform(k, (64,), minval=a, maxval=b) for k, a, b in ((x_key, -1, 72), (y_key, -2, 2)))
        half = jax.random.uniform(yaw_key, (64,), minval=-np.pi / 2, maxval=np.pi / 2)
        z = jax.vmap(lambda x, y: ground_height(world, x, y))(x, y) + A1.stand_height
        place = jp.stack([x, y, z, jp.cos(half), 0 * half, 0 * half, jp.sin(half)], axis=1)
        robots = jp.concatenate([place, jp.broadcast_to(jp.array(A1.default_pose), (64, 12))], axis=1)
        return jax.vmap(lambda robot: broadphase(world, A1, robot, PhysicsConfig()).dropped)(robots)

    counts = jax.jit(lambda keys: jax.lax.map(left_out, keys))(jax.random.split(jax.random.PRNGKey(1), 8))
    assert int(counts.max()) == 0


def _touch(boxes: list[dict], trees: list[dict] = (), slots: int = 1, height: float = 1.0):
    """ContactSlots of one robot in the default pose, its trunk at `height`, over boxes; environments' axis dropped."""
    return _slots(scene(boxes, trees), jp.asarray(standing(height=height)), slots)


@partial(jax.jit, static_argnums=2)
def _slots(world: Scene, qpos: jax.Array, slots: int) -> ContactSlots:
    picked = broadphase(world, A1, qpos, PhysicsConfig())
    last = jax.tree.map(lambda x: x[..., None], picked)
    return jax.tree.map(
        lambda x: x[..., 0], narrowphase(FusionBarrier(), last, A1, centers(A1, pose(A1, qpos[:, None])), slots)
    )


def test_each_foot_has_the_ground_and_the_nearest_obstacle():
    front_left = {"center": (0.183, 0.13205, 0.0), "half": (0.05, 0.05, 0.7), "kind": STEP}
    found = _touch([front_left])
    foot_z = 1.0 - 0.4 * np.cos(0.9) - 0.02
    np.testing.assert_allclose(found.feet[0].distance, foot_z, atol=1e-6)
    np.testing.assert_allclose(found.feet[1].distance[1], foot_z - 0.7, atol=1e-5)
    np.testing.assert_allclose([n[1] for n in found.feet[1].normal], (0, 0, 1), atol=1e-6)
    assert not found.hit


def test_second_slot_holds_the_second_nearest():
    low = {"center": (0.0, 0.0, 0.0), "half": (5.0, 5.0, 0.30), "kind": STEP}
    high = {"center": (0.0, 0.0, 0.0), "half": (5.0, 5.0, 0.50), "kind": STEP}
    foot_z = 1.0 - 0.4 * np.cos(0.9) - 0.02
    for boxes in ([low, high], [high, low]):
        found = _touch(boxes, slots=2)
        np.testing.assert_allclose(found.feet[1].distance, foot_z - 0.5, atol=1e-5)
        np.testing.assert_allclose(found.feet[2].distance, foot_z - 0.3, atol=1e-5)


def test_other_spheres_have_the_nearest_of_ground_and_obstacles():
    table = {"center": (0.2, 0.0, 0.9), "half": (0.01, 0.01, 0.02), "kind": STEP}  # just below the trunk's front
    found = _touch([table])
    np.testing.assert_allclose(found.trunk.distance[0], 0.08 - A1.radii[-1], atol=1e-5)
    np.testing.assert_allclose([n[0] for n in found.trunk.normal], (0, 0, 1), atol=1e-5)
    # From the rear sphere, 0.4 m behind: the table's edge, 0.39 m ahead and 0.08 m below.
    np.testing.assert_allclose(found.trunk.distance[1], np.hypot(0.39, 0.08) - A1.radii[-1], atol=1e-5)
    alone = _touch([])
    np.testing.assert_allclose(alone.trunk.distance, 1.0 - A1.radii[-1], atol=1e-6)
    np.testing.assert_allclose(alone.hips.distance, 1.0 - 0.045, atol=1e-6)


@pytest.mark.parametrize(("kind", "hit"), [(OBSTACLE, True), (WALL, True), (STEP, False)])
def test_touching_obstacles_and_walls_is_a_collision_touching_steps_is_not(kind, hit):
    margin = 0.0 if kind == STEP else 0.05
    gap = 0.2 + 0.057 + margin + 0.1  # the front sphere's end, the margin, the box's own half
    box = lambda x: {"center": (x, 0.0, 1.0), "half": (0.1, 0.3, 0.1), "kind": kind}  # noqa: E731
    assert bool(_touch([box(gap - 0.002)]).hit) == hit
    assert not bool(_touch([box(gap + 0.002)]).hit)


def test_touching_a_tree_is_a_collision():
    tree = lambda x: {"center": (x, 0.0, 1.0), "radius": 0.1, "half_height": 1.0}  # noqa: E731
    reach = 0.2 + 0.057 + 0.05 + 0.1
    assert bool(_touch([], [tree(reach - 0.002)]).hit)
    assert not bool(_touch([], [tree(reach + 0.002)]).hit)


def test_gaps_do_not_depend_on_how_many_boxes_there_are():
    one = {"center": (0.4, 0.0, 0.5), "half": (0.1, 0.3, 0.5), "kind": OBSTACLE}
    crowd = [{"center": (3.0 + i, 2.0, 0.5), "half": (0.1, 0.1, 0.5), "kind": OBSTACLE} for i in range(40)]
    few, many = _touch([one]), _touch([one, *crowd])
    for a, b in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        np.testing.assert_allclose(a, b)
