"""From a scene to contact slots: for every sphere of the robot, the tangent plane of what is nearest to it.

Broadphase: once per control step the few boxes and cylinders within reach are picked. Narrowphase: in every physics
step each sphere is measured against those and the ground. The cost does not depend on how much the scene holds.
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
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.robots import Robot
from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import COLLISION_MARGIN, STEP, Scene, Terrain

FAR = 1e3  # m, the distance of nothing
REACH = 0.1  # m, what a sphere may move in a control step: 2.5 m/s


class Box(NamedTuple):
    """A box for contact: center (3,), half extents (3,), m, and turn (2,), cosine and sine of its yaw."""

    center: jax.Array
    half: jax.Array
    turn: jax.Array


class Cylinder(NamedTuple):
    """An upright cylinder for contact: center (3,), radius and half height, m."""

    center: jax.Array
    radius: jax.Array
    half: jax.Array


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


class Planes(NamedTuple):
    """Tangent planes, one per slot.

    Attributes:
        distance: signed distance of a sphere's surface, or of a point, to the plane, m; negative in contact.
        normal: x, y, z, each of the same shape, unit, out of the obstacle.
    """

    distance: jax.Array
    normal: Vector


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


def _sub(point: Vector, center: jax.Array) -> Vector:
    return (point[0] - center[0], point[1] - center[1], point[2] - center[2])


def _into_box(point: Vector, box: Box) -> tuple[Vector, Vector]:
    """Points in the box's frame, and how far they are beyond its faces along each axis."""
    x, y, z = _sub(point, box.center)
    cos, sin = box.turn[0], box.turn[1]
    local = (cos * x + sin * y, cos * y - sin * x, z)
    return local, tuple(jp.abs(local[i]) - box.half[i] for i in range(3))  # type: ignore[return-value]


def box_distance(point: Vector, box: Box) -> jax.Array:
    """Signed distance of points (x, y, z of any one shape) to a box's surface, negative inside, m."""
    over = _into_box(point, box)[1]
    x, y, z = (jp.maximum(o, 0.0) for o in over)
    inside = jp.minimum(jp.maximum(jp.maximum(over[0], over[1]), over[2]), 0.0)
    return jp.sqrt(x * x + y * y + z * z) + inside


def box_plane(point: Vector, box: Box) -> Planes:
    """Tangent plane of a box at its surface's nearest point to each of some points.

    Outside the box that is the nearest point of face, edge or corner; inside, the nearest face.
    """
    local, over = _into_box(point, box)
    deepest = jp.maximum(jp.maximum(over[0], over[1]), over[2])
    inside = deepest <= 0.0
    # Inside, only the face that is nearest: x before y before z where they tie.
    on_x = over[0] >= deepest
    on_y = (over[1] >= deepest) & ~on_x
    out = [
        jp.where(inside, on.astype(o.dtype), jp.maximum(o, 0.0))
        for o, on in zip(over, (on_x, on_y, ~(on_x | on_y)), strict=True)
    ]
    length = jp.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    x, y, z = (jp.where(side < 0.0, -o, o) / length for side, o in zip(local, out, strict=True))
    cos, sin = box.turn[0], box.turn[1]
    return Planes(jp.where(inside, deepest, length), (cos * x - sin * y, sin * x + cos * y, z))


def _around(point: Vector, cylinder: Cylinder) -> tuple[Vector, jax.Array, jax.Array, jax.Array]:
    """Points relative to a cylinder's centre, their distance to its axis, and to its side and caps, negative inside."""
    local = _sub(point, cylinder.center)
    axial = jp.sqrt(local[0] * local[0] + local[1] * local[1])
    return local, axial, axial - cylinder.radius, jp.abs(local[2]) - cylinder.half


def cylinder_distance(point: Vector, cylinder: Cylinder) -> jax.Array:
    """Signed distance of points to an upright cylinder's surface, negative inside, m."""
    _, _, side, cap = _around(point, cylinder)
    out_side, out_cap = jp.maximum(side, 0.0), jp.maximum(cap, 0.0)
    return jp.sqrt(out_side * out_side + out_cap * out_cap) + jp.minimum(jp.maximum(side, cap), 0.0)


def cylinder_plane(point: Vector, cylinder: Cylinder) -> Planes:
    """Tangent plane of an upright cylinder nearest to each of some points, as :func:`box_plane`."""
    local, axial, side, cap = _around(point, cylinder)
    deepest = jp.maximum(side, cap)
    inside = deepest <= 0.0
    out_side = jp.where(inside, (side >= cap).astype(side.dtype), jp.maximum(side, 0.0))
    out_cap = jp.where(inside, (side < cap).astype(side.dtype), jp.maximum(cap, 0.0))
    length = jp.sqrt(out_side * out_side + out_cap * out_cap)
    # On the axis any direction will do; x is taken.
    centred = axial == 0.0
    radial = out_side / (length * jp.where(centred, 1.0, axial))
    normal = (radial * jp.where(centred, 1.0, local[0]), radial * local[1], jp.sign(local[2]) * out_cap / length)
    return Planes(jp.where(inside, deepest, length), normal)


def ground_plane(terrain: Terrain | None, point: Vector) -> Planes:
    """Tangent plane of the ground beneath each of some points: of z = 0, or of the triangle of the heightfield."""
    if terrain is None:
        zero = jp.zeros_like(point[2])
        return Planes(point[2], (zero, zero, zero + 1.0))
    if point[0].ndim == 2:  # many environments, each over its own heightfield
        of_each = jax.vmap(ground, in_axes=(0, -1, -1), out_axes=-1)
        height, slope_x, slope_y = of_each(terrain, point[0], point[1])
    else:
        height, slope_x, slope_y = ground(terrain, point[0], point[1])
    up = jax.lax.rsqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return Planes((point[2] - height) * up, (-slope_x * up, -slope_y * up, up))


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
