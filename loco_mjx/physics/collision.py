"""From a scene to contact slots: for every sphere of the robot, the tangent plane of what is nearest to it.

Broadphase: once per control step the few boxes and cylinders within reach are picked. Narrowphase: in every physics
step each sphere is measured against those and the ground. The cost hardly depends on how much the scene holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jp
import numpy as np
from flax import struct

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.block_matrix import LEGS
from loco_mjx.physics.kinematics import Vector, column, sphere_centers
from loco_mjx.physics.shapes import (
    Box,
    Cylinder,
    Planes,
    box_distance,
    box_plane,
    cylinder_distance,
    cylinder_plane,
    ground_plane,
)
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.robots import Robot
from loco_mjx.scene.types import COLLISION_MARGIN, STEP, Scene, Terrain

FAR = 1e3  # m, the distance of nothing
REACH = 0.1  # m, what a sphere may move in a control step: 2.5 m/s


@struct.dataclass
class Candidates:
    """What the broadphase leaves: all that may touch the robot within one control step.

    Attributes:
        boxes: K of them, on the first axis.
        solid: (K,) bool, whether touching the box counts as a collision (steps do not).
        cylinders: C of them, on the first axis.
        terrain: the ground's heightfield or None.
        dropped: int32, how many other boxes and cylinders are within REACH of a sphere, and are not felt.
    """

    boxes: Box
    solid: jax.Array
    cylinders: Cylinder
    terrain: Terrain | None
    dropped: jax.Array


class ContactSlots(NamedTuple):
    """Contact slots of all spheres.

    Attributes:
        feet: planes (4,): the ground's, then the nearest obstacles' and steps', nearest first.
        hips: (4,) the nearest of everything.
        knees: planes (4,): the nearest of everything, which has friction, then the others of the feet's, which have
            none: a robot on its knees leans against walls.
        calves: (4,) the nearest of everything.
        trunk: (T,) the nearest of everything.
        hit: bool, whether any sphere touches an obstacle or a wall.
    """

    feet: tuple[Planes, ...]
    hips: Planes
    knees: tuple[Planes, ...]
    calves: Planes
    trunk: Planes
    hit: jax.Array


def _kept(shapes: Box | Cylinder, distance: jax.Array, count: int) -> tuple[Any, jax.Array, jax.Array]:
    """The `count` shapes nearest to any sphere, their indices, and how many others are within reach.

    Args:
        shapes: S of them.
        distance: (S,) of each to the sphere nearest to it, m.
        count: how many to keep.
    """
    number = min(count, distance.shape[0])
    pick = jax.lax.top_k(-distance, number)[1]
    within = jp.sum(distance < REACH, dtype=jp.int32)
    return jax.tree.map(lambda a: a[pick], shapes), pick, jp.maximum(within - number, 0)


def broadphase(scene: Scene, robot: Robot, qpos: jax.Array, config: PhysicsConfig) -> Candidates:
    """Picks the boxes and cylinders nearest to the robot's spheres, and counts what is left out within their reach.

    Args:
        scene: the world.
        robot: whose spheres.
        qpos: (19,) its configuration.
        config: how many to keep (`near_boxes`, `near_cylinders`).
    """
    point = sphere_centers(robot, qpos)
    gap = lambda distance, shapes: jp.min(  # noqa: E731
        jax.vmap(lambda shape: distance(point, shape) - column(robot.radii, point[0]))(shapes), axis=1
    )
    boxes, cylinders = scene.boxes, scene.cylinders
    turn = jp.stack([jp.cos(boxes.yaw), jp.sin(boxes.yaw)], axis=-1)
    every_box = Box(boxes.center, boxes.collision_half, turn)
    every_cylinder = Cylinder(cylinders.center, cylinders.radius + COLLISION_MARGIN, cylinders.half_height)
    near_boxes, pick, more_boxes = _kept(every_box, gap(box_distance, every_box), config.near_boxes)
    gaps = gap(cylinder_distance, every_cylinder)
    near_cylinders, _, more_cylinders = _kept(every_cylinder, gaps, config.near_cylinders)
    solid = boxes.kind[pick] != STEP
    return Candidates(near_boxes, solid, near_cylinders, scene.terrain, more_boxes + more_cylinders)


def _choose(pick: jax.Array, first: Planes, second: Planes) -> Planes:
    return jax.tree.map(lambda a, b: jp.where(pick, a, b), first, second)


class _Ranking(NamedTuple):
    """The nearest obstacles to each sphere, nearest first: distances and indices; and whether any is touched."""

    distance: list[jax.Array]
    number: list[jax.Array]
    hit: jax.Array


def _rank(scene: Candidates, point: Vector, radii: np.ndarray, count: int) -> _Ranking:
    """Runs through boxes, then cylinders, keeping the `count` nearest of each sphere without sorting."""
    distances = [
        distances_to(scene.boxes, box_distance, point),
        distances_to(scene.cylinders, cylinder_distance, point),
    ]
    kept = [jp.full_like(point[0], FAR)] * count
    index = [jp.zeros(point[0].shape, jp.int32)] * count
    hit = jp.zeros(point[0].shape, bool)
    for number, distance in enumerate(distances[0] + distances[1]):
        touched = distance < radii
        hit = hit | (touched & scene.solid[number] if number < len(distances[0]) else touched)
        candidate = jp.full(point[0].shape, number, jp.int32)
        for slot in range(count):
            closer = distance < kept[slot]
            kept[slot], distance = jp.where(closer, distance, kept[slot]), jp.where(closer, kept[slot], distance)
            index[slot], candidate = jp.where(closer, candidate, index[slot]), jp.where(closer, index[slot], candidate)
    return _Ranking(kept, index, jp.any(hit, axis=0))


def distances_to(
    shapes: Box | Cylinder, distance: Callable[[Vector, Any], jax.Array], point: Vector
) -> list[jax.Array]:
    """Signed distances of points to each of some shapes."""
    each = range(shapes.center.shape[0])
    return [distance(point, jax.tree.map(lambda a, k=k: a[k], shapes)) for k in each]


def _gathered(shapes: Box | Cylinder, index: jax.Array) -> Box | Cylinder:
    """For each sphere the shape of its index: fields (..., spheres, N); by selection, as a gather goes one by one."""

    def select(field: jax.Array) -> jax.Array:
        chosen = field[0][..., None, :]
        for k in range(1, field.shape[0]):
            chosen = jp.where(index == k, field[k][..., None, :], chosen)
        return chosen

    return jax.tree.map(select, shapes)


def narrowphase(
    barrier: FusionBarrier, scene: Candidates, robot: Robot, point: Vector, obstacle_slots: int
) -> ContactSlots:
    """Contact slots of all spheres, of N environments.

    Args:
        barrier: keeps XLA from computing intermediate results again.
        scene: what is near; each array's last axis is over environments, the terrain's first.
        robot: whose spheres.
        point: x, y, z of their centres, each (S, N), m, in the order of `robot.spheres`.
        obstacle_slots: per foot and knee, how many of the nearest boxes and cylinders beside the ground.
    """
    radii = column(robot.radii, point[0])
    floor = barrier(ground_plane, scene.terrain, point)
    ranking = barrier(lambda: _rank(scene, point, radii, obstacle_slots))
    ranked = zip(ranking.distance, ranking.number, strict=True)
    nearest = [barrier(_plane_of, scene, point, distance, number) for distance, number in ranked]
    single = barrier(lambda: _choose(nearest[0].distance < floor.distance, nearest[0], floor))
    cut = lambda plane, a, b: jax.tree.map(lambda x: x[a:b], plane._replace(distance=plane.distance - radii))  # noqa: E731
    feet = tuple(cut(plane, 0, LEGS) for plane in (floor, *nearest))
    other = barrier(lambda: _choose(nearest[0].distance < floor.distance, floor, nearest[0]))
    knees = tuple(cut(plane, 2 * LEGS, 3 * LEGS) for plane in (single, other, *nearest[1:]))
    hips, calves, trunk = (cut(single, a * LEGS, b and b * LEGS) for a, b in ((1, 2), (3, 4), (4, None)))
    return ContactSlots(feet, hips, knees, calves, trunk, ranking.hit)


def _plane_of(scene: Candidates, point: Vector, distance: jax.Array, index: jax.Array) -> Planes:
    """Tangent planes of the boxes or cylinders of the given indices; those at the distance FAR are of nothing."""
    plane = Planes(jp.full_like(distance, FAR), tuple(jp.zeros_like(c) for c in point))  # type: ignore[arg-type]
    count = scene.boxes.center.shape[0]
    if count:
        box = box_plane(point, _gathered(scene.boxes, index))  # type: ignore[arg-type]
        plane = _choose(index < count, box, plane)
    if scene.cylinders.center.shape[0]:
        cylinder = cylinder_plane(point, _gathered(scene.cylinders, index - count))  # type: ignore[arg-type]
        plane = _choose(index >= count, cylinder, plane)
    return plane._replace(distance=jp.where(distance >= FAR, FAR, plane.distance))
