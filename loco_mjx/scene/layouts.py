"""One function per task: a key in, one freshly drawn Scene out. Static shapes; batches come from ``jax.vmap``."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jp

from loco_mjx.scene import motion, terrain
from loco_mjx.scene.parts import join, make_boxes, make_scene, scatter, walls
from loco_mjx.scene.passage import opened
from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import COLLISION_MARGIN, OBSTACLE, STEP, Boxes, Cylinders, Scene, Spheres, Terrain

GOAL_RADIUS = 0.8  # m, the red sphere on a summit
# m, as far as obstacles stand: a robot at 1.7 m/s meets them during a whole episode. The counts below follow from the
# paper's density: 50 pillars on 26 m, 50 spheres on 28 m.
COURSE_END = 73.0
THIN_COUNT = 135
THIN_LOW, THIN_HIGH = (2.5, -3.0), (COURSE_END, 3.0)  # m, rectangle of the centres
THIN_DISTANCE = 1.0  # m between any two centres
THIN_HALF = (0.18, 0.18, 0.7)  # m
THIN_WALL, THIN_WALL_HALF = 3.1, 0.106  # m, the walls' centres at ±y and half thickness
SHAPE_LOW, SHAPE_HIGH = 0.163, 0.52  # m, half sides of pillars of random shape
SHAPE_WAY = 0.4  # m that stay free from end to end; the robot is 0.354 m wide
WIDE_PERIODS = 10  # rows of one block and of two, 7 m from each to the next
WIDE_GAP = 0.6  # m that stay free between the two blocks of a row
SPHERE_COUNT = 127
SPHERE_RADIUS = 0.2  # m
SPHERE_LOW, SPHERE_HIGH = (2.0, -2.2), (COURSE_END, 2.2)  # m
INDOOR_COUNT = 39
TREE_COUNT = 135
TREE_DISTANCE = 1.2  # m
STEP_COUNT, STEP_RISE = 4, 0.10  # m


def _thin_centers(key: jax.Array, height: float = THIN_HALF[2]) -> jax.Array:
    """(THIN_COUNT, 3) centres of the thin obstacles."""
    xy = scatter(key, THIN_COUNT, THIN_LOW, THIN_HIGH, THIN_DISTANCE)
    return jp.concatenate([xy, jp.full((THIN_COUNT, 1), height, jp.float32)], axis=1)


def _thin_walls() -> Boxes:
    return walls(THIN_WALL, THIN_WALL_HALF, height=4.2)


def thin(key: jax.Array) -> Scene:
    """Pillars, 1.4 m tall, scattered between two walls."""
    obstacles = make_boxes(_thin_centers(key), jp.array(THIN_HALF))
    return make_scene(join(obstacles, _thin_walls()))


def wide(key: jax.Array) -> Scene:
    """Wide blocks, 1 m tall, in a fixed pattern with jitter, between two walls; every row has a gap of WIDE_GAP."""
    pattern = [(3.0, -0.75), (3.0, 0.75)]
    pattern += [(6.0 + 7.0 * i, 0.0) for i in range(WIDE_PERIODS)]
    pattern += [(9.0 + 7.0 * i, side) for i in range(WIDE_PERIODS) for side in (-1.3, 1.3)]
    half = jp.array([(0.25, 0.4, 0.5)] * 2 + [(0.25, 0.8, 0.5)] * (3 * WIDE_PERIODS))
    # jitter = +U(-0.1, 0.1) m in x, +U(-0.4, 0.4) m in y
    jitter = jax.random.uniform(key, (len(pattern), 2), minval=-1.0, maxval=1.0) * jp.array([0.1, 0.4])
    xy = _parted(jp.array(pattern) + jitter)
    center = jp.concatenate([xy, jp.full((len(pattern), 1), 0.5)], axis=1)
    return make_scene(join(make_boxes(center, half), walls(2.3, half_thickness=0.25, height=1.0)))


def _parted(xy: jax.Array) -> jax.Array:
    """The blocks of ``wide``, those of a pair moved apart, each by as much, where less than WIDE_GAP is between them.

    Beside a single block, or a block of the first pair, 0.7 m are free whatever the jitter.
    """
    single = 2 + WIDE_PERIODS
    right, left = xy[single::2, 1], xy[single + 1 :: 2, 1]
    missing = jp.maximum(WIDE_GAP + 2.0 * (0.8 + COLLISION_MARGIN) - (left - right), 0.0)
    apart = jp.stack([right - 0.5 * missing, left + 0.5 * missing], axis=1).reshape(-1)
    return xy.at[single:, 1].set(apart)


def _collectable(key: jax.Array) -> Spheres:
    """Spheres to collect, resting on z = 0."""
    # centre = +U(SPHERE_LOW, SPHERE_HIGH)
    xy = jax.random.uniform(key, (SPHERE_COUNT, 2), minval=jp.array(SPHERE_LOW), maxval=jp.array(SPHERE_HIGH))
    return Spheres(
        center=jp.concatenate([xy, jp.full((SPHERE_COUNT, 1), SPHERE_RADIUS)], axis=1),
        radius=jp.full((SPHERE_COUNT,), SPHERE_RADIUS, jp.float32),
        collected=jp.zeros((SPHERE_COUNT,), bool),
        reward=jp.ones((SPHERE_COUNT,), bool),
    )


def thin_sphere(key: jax.Array) -> Scene:
    """``thin`` with spheres to collect."""
    layout_key, sphere_key = jax.random.split(key)
    return replace(thin(layout_key), spheres=_collectable(sphere_key))


def wide_sphere(key: jax.Array) -> Scene:
    """``wide`` with spheres to collect."""
    layout_key, sphere_key = jax.random.split(key)
    return replace(wide(layout_key), spheres=_collectable(sphere_key))


def moving(key: jax.Array) -> Scene:
    """``thin``, four pillars of five translating (see loco_mjx/scene/motion.py)."""
    layout_key, direction_key = jax.random.split(key)
    scene = thin(layout_key)
    obstacle = (scene.boxes.kind == OBSTACLE)[:, None]
    velocity = jp.where(obstacle, motion.draw_velocity(direction_key, scene.boxes.count), 0.0)
    return replace(scene, boxes=replace(scene.boxes, velocity=velocity))


def heightfield(key: jax.Array) -> Scene:
    """``thin`` on uneven ground."""
    layout_key, terrain_key = jax.random.split(key)
    return replace(thin(layout_key), terrain=terrain.uneven(terrain_key))


def random_shape(key: jax.Array) -> Scene:
    """``thin`` with every pillar's size drawn; where they would close the corridor, they are made smaller."""
    layout_key, side_key, height_key = jax.random.split(key, 3)
    # half x, half y = +U(0.163, 0.52) m
    sides = jax.random.uniform(side_key, (THIN_COUNT, 2), minval=SHAPE_LOW, maxval=SHAPE_HIGH)
    # half z = +U(0.45, 0.95) m
    tall = jax.random.uniform(height_key, (THIN_COUNT, 1), minval=0.45, maxval=0.95)
    xy = _thin_centers(layout_key)[:, :2]
    sides = opened(xy, sides, SHAPE_LOW, THIN_WALL - THIN_WALL_HALF - COLLISION_MARGIN, SHAPE_WAY)
    center = jp.concatenate([xy, tall], axis=1)
    return make_scene(join(make_boxes(center, jp.concatenate([sides, tall], axis=1)), _thin_walls()))


def indoor(key: jax.Array) -> Scene:
    """A corridor, 3 m wide, with turned cartons and cabinets in the way; a robot fits past every one."""
    place_key, size_key, yaw_key = jax.random.split(key, 3)
    row = 3.0 + 1.8 * jp.arange(INDOOR_COUNT)
    # offset = +U(-0.2, 0.2) m in x, +U(-1.1, 1.1) m in y
    offset = jax.random.uniform(place_key, (INDOOR_COUNT, 2), minval=-1.0, maxval=1.0) * jp.array([0.2, 1.1])
    # half = +U((0.15, 0.15, 0.2), (0.3, 0.4, 0.6)) m
    low, high = jp.array([0.15, 0.15, 0.2]), jp.array([0.3, 0.4, 0.6])
    half = jax.random.uniform(size_key, (INDOOR_COUNT, 3), minval=low, maxval=high)
    # yaw = +U(-0.5, 0.5) rad
    yaw = jax.random.uniform(yaw_key, (INDOOR_COUNT,), minval=-0.5, maxval=0.5)
    center = jp.stack([row + offset[:, 0], offset[:, 1], half[:, 2]], axis=1)
    return make_scene(join(make_boxes(center, half, yaw=yaw), walls(1.6, half_thickness=0.1, height=2.4)))


def forest(key: jax.Array) -> Scene:
    """Trees on rough, sloped ground with potholes."""
    place_key, radius_key, terrain_key = jax.random.split(key, 3)
    floor = terrain.forest_floor(terrain_key)
    xy = scatter(place_key, TREE_COUNT, (THIN_LOW[0], -5.0), (COURSE_END, 5.0), TREE_DISTANCE)
    # radius = +U(0.1, 0.2) m
    radius = jax.random.uniform(radius_key, (TREE_COUNT,), minval=0.1, maxval=0.2)
    root, _, _ = ground(floor, xy[:, 0], xy[:, 1])
    half_height = jp.full((TREE_COUNT,), 1.5, jp.float32)
    center = jp.stack([xy[:, 0], xy[:, 1], root + half_height - 0.4], axis=1)  # 0.4 m of trunk in the ground
    return make_scene(cylinders=Cylinders(center, radius, half_height), ground_field=floor)


def _summit(field: Terrain, goal: jax.Array) -> Scene:
    """A terrain with its goal marked by a sphere that is seen and never collected."""
    marker = Spheres(
        center=goal[None, :],
        radius=jp.full((1,), GOAL_RADIUS, jp.float32),
        collected=jp.zeros((1,), bool),
        reward=jp.zeros((1,), bool),
    )
    return make_scene(spheres=marker, ground_field=field, goal=goal)


def mountain(key: jax.Array) -> Scene:
    """A rugged mountain: its foot at the start, the goal on the summit."""
    return _summit(*terrain.mountain(key))


def hill(key: jax.Array) -> Scene:
    """Rolling hills, the goal on top of the highest."""
    return _summit(*terrain.hill(key))


def stairs(key: jax.Array) -> Scene:
    """Four steps up, a plateau, four steps down: nested slabs that reach well below the ground.

    A slab's bottom is far below, so that a foot pressed into a riser is pushed back along x, never down.
    """
    start_key, run_key, plateau_key = jax.random.split(key, 3)
    # first riser = +U(1.75, 2.25) m, depth of a step = +U(0.40, 0.48) m, plateau = +U(3.5, 4.5) m
    start = jax.random.uniform(start_key, minval=1.75, maxval=2.25)
    run = jax.random.uniform(run_key, minval=0.40, maxval=0.48)
    plateau = jax.random.uniform(plateau_key, minval=3.5, maxval=4.5)
    level = jp.arange(STEP_COUNT)
    half_x = 0.5 * plateau + run * (STEP_COUNT - 1 - level)
    middle = start + run * (STEP_COUNT - 1) + 0.5 * plateau
    top, bottom = STEP_RISE * (level + 1), -0.4
    center = jp.stack([jp.full((STEP_COUNT,), middle), jp.zeros((STEP_COUNT,)), 0.5 * (top + bottom)], axis=1)
    half = jp.stack([half_x, jp.full((STEP_COUNT,), 25.0), 0.5 * (top - bottom)], axis=1)
    return make_scene(make_boxes(center, half, STEP))
