"""From a scene to contact slots: for every sphere of the robot, the tangent plane of what is nearest to it.

Once per control step the few boxes and cylinders within reach are picked (:func:`near`); in every physics step each
sphere is measured against those and the ground (:func:`touch`). The cost does not depend on how much the scene holds.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.kinematics import LEGS, RADII, Vector, column
from loco_mjx.scene.surface import ground
from loco_mjx.scene.types import COLLISION_MARGIN, STEP, Boxes, Cylinders, Scene, Terrain

FAR = 1e3  # m, the distance of nothing


@struct.dataclass
class Near:
    """What may touch the robot within one control step.

    Attributes:
        box_center: (K, 3) m.
        box_half: (K, 3) half extents of the collision boxes, m.
        box_turn: (K, 2) cosine and sine of the yaw.
        box_solid: (K,) bool, whether touching it counts as a collision (steps do not).
        cylinder_center: (C, 3) m.
        cylinder_radius: (C,) collision radii, m.
        cylinder_half: (C,) half heights, m.
        terrain: the ground's heightfield or None.
    """

    box_center: jax.Array
    box_half: jax.Array
    box_turn: jax.Array
    box_solid: jax.Array
    cylinder_center: jax.Array
    cylinder_radius: jax.Array
    cylinder_half: jax.Array
    terrain: Terrain | None


class Planes(NamedTuple):
    """Tangent planes, one per slot.

    Attributes:
        distance: (...,) signed distance of the sphere's surface to the plane, m; negative in contact.
        normal: x, y, z, each (...,), unit, out of the obstacle.
    """

    distance: jax.Array
    normal: Vector


def _nearest(distance: jax.Array, count: int) -> jax.Array:
    """Indices of the `count` smallest of (N,) distances."""
    return jax.lax.top_k(-distance, min(count, distance.shape[0]))[1]


def _near_boxes(boxes: Boxes, base: jax.Array, count: int) -> tuple[jax.Array, ...]:
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    half = boxes.collision_half
    dx, dy, dz = (base[i] - boxes.center[:, i] for i in range(3))
    out_x = jp.maximum(jp.abs(cos * dx + sin * dy) - half[:, 0], 0.0)
    out_y = jp.maximum(jp.abs(cos * dy - sin * dx) - half[:, 1], 0.0)
    out_z = jp.maximum(jp.abs(dz) - half[:, 2], 0.0)
    pick = _nearest(out_x**2 + out_y**2 + out_z**2, count)
    turn = jp.stack([cos, sin], axis=-1)
    return boxes.center[pick], half[pick], turn[pick], boxes.kind[pick] != STEP


def _near_cylinders(cylinders: Cylinders, base: jax.Array, count: int) -> tuple[jax.Array, ...]:
    radius = cylinders.radius + COLLISION_MARGIN
    flat = jp.sqrt((base[0] - cylinders.center[:, 0]) ** 2 + (base[1] - cylinders.center[:, 1]) ** 2) - radius
    pick = _nearest(flat, count)
    return cylinders.center[pick], radius[pick], cylinders.half_height[pick]


def near(scene: Scene, base: jax.Array, config: PhysicsConfig) -> Near:
    """Picks the boxes and cylinders nearest to the robot's base.

    Args:
        scene: the world.
        base: (3,) position of the trunk, m.
        config: how many to keep (`near_boxes`, `near_cylinders`).
    """
    boxes = _near_boxes(scene.boxes, base, config.near_boxes)
    cylinders = _near_cylinders(scene.cylinders, base, config.near_cylinders)
    return Near(*boxes, *cylinders, scene.terrain)


def box_plane(point: Vector, center: jax.Array, half: jax.Array, turn: jax.Array) -> Planes:
    """Tangent plane of one box at its surface's nearest point to each of some points.

    Outside the box that is the nearest point of face, edge or corner; inside, the nearest face.

    Args:
        point: x, y, z, each (S,), m.
        center: (3,) m.
        half: (3,) half extents, m.
        turn: (2,) cosine and sine of the yaw.
    """
    cos, sin = turn[0], turn[1]
    dx, dy, dz = (point[i] - center[i] for i in range(3))
    local = (cos * dx + sin * dy, cos * dy - sin * dx, dz)
    over = tuple(jp.abs(local[i]) - half[i] for i in range(3))
    deepest = jp.maximum(jp.maximum(over[0], over[1]), over[2])
    inside = deepest <= 0.0
    # Inside, only the face that is nearest: x before y before z where they tie.
    on_x = over[0] >= deepest
    on_y = (over[1] >= deepest) & ~on_x
    out = tuple(
        jp.where(inside, on.astype(o.dtype), jp.maximum(o, 0.0))
        for o, on in zip(over, (on_x, on_y, ~(on_x | on_y)), strict=True)
    )
    length = jp.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    scale = 1.0 / length
    nx, ny, nz = (jp.where(side < 0.0, -o, o) * scale for side, o in zip(local, out, strict=True))
    return Planes(jp.where(inside, deepest, length), (cos * nx - sin * ny, sin * nx + cos * ny, nz))


def cylinder_plane(point: Vector, center: jax.Array, radius: jax.Array, half: jax.Array) -> Planes:
    """Tangent plane of one upright cylinder nearest to each of some points; arguments as in :func:`box_plane`."""
    dx, dy, dz = (point[i] - center[i] for i in range(3))
    flat = jp.sqrt(dx * dx + dy * dy)
    # On the axis any direction will do; x is taken.
    rx, ry = jp.where(flat > 0.0, dx, 1.0) / jp.where(flat > 0.0, flat, 1.0), dy / jp.where(flat > 0.0, flat, 1.0)
    side, cap = flat - radius, jp.abs(dz) - half
    inside = jp.maximum(side, cap) <= 0.0
    on_side = side >= cap
    out_side = jp.where(inside, on_side.astype(side.dtype), jp.maximum(side, 0.0))
    out_cap = jp.where(inside, (~on_side).astype(side.dtype), jp.maximum(cap, 0.0))
    length = jp.sqrt(out_side * out_side + out_cap * out_cap)
    scale = 1.0 / length
    normal = (rx * out_side * scale, ry * out_side * scale, jp.where(dz < 0.0, -out_cap, out_cap) * scale)
    return Planes(jp.where(inside, jp.maximum(side, cap), length), normal)


def ground_plane(terrain: Terrain | None, point: Vector) -> Planes:
    """Tangent plane of the ground beneath each of some points: of z = 0, or of the triangle of the heightfield."""
    if terrain is None:
        zero = jp.zeros_like(point[2])
        return Planes(point[2], (zero, zero, zero + 1.0))
    if point[0].ndim == 2:  # many environments, each over its own heightfield
        spread = jax.vmap(ground, in_axes=(0, -1, -1), out_axes=-1)
        height, slope_x, slope_y = spread(terrain, point[0], point[1])
    else:
        height, slope_x, slope_y = ground(terrain, point[0], point[1])
    up = jax.lax.rsqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return Planes((point[2] - height) * up, (-slope_x * up, -slope_y * up, up))


def _closer(first: Planes, second: Planes, where: jax.Array) -> Planes:
    pick = lambda a, b: jp.where(where, a, b)  # noqa: E731
    return Planes(pick(first.distance, second.distance), tuple(map(pick, first.normal, second.normal)))  # type: ignore[arg-type]


def _insert(slots: tuple[Planes, ...], plane: Planes) -> tuple[Planes, ...]:
    """Keeps the nearest planes, nearest first, without sorting."""
    kept = []
    for slot in slots:
        closer = plane.distance < slot.distance
        kept.append(_closer(plane, slot, closer))
        plane = _closer(slot, plane, closer)
    return tuple(kept)


def _candidates(scene: Near, point: Vector) -> list[tuple[Planes, jax.Array | bool]]:
    """Planes of everything but the ground, each with whether touching it is a collision."""
    boxes = [
        (box_plane(point, scene.box_center[k], scene.box_half[k], scene.box_turn[k]), scene.box_solid[k])
        for k in range(scene.box_center.shape[0])
    ]
    cylinders = [
        (cylinder_plane(point, scene.cylinder_center[k], scene.cylinder_radius[k], scene.cylinder_half[k]), True)
        for k in range(scene.cylinder_center.shape[0])
    ]
    return boxes + cylinders


def touch(
    scene: Near, point: Vector, obstacle_slots: int
) -> tuple[tuple[tuple[Planes, ...], Planes, Planes, Planes], jax.Array]:
    """Contact slots of all spheres.

    Args:
        scene: what is near.
        point: x, y, z of the spheres' centres, each (18,), m, in the order of kinematics.SPHERES.
        obstacle_slots: per foot, how many of the nearest boxes and cylinders beside the ground.

    Returns:
        Planes: of the feet (4,) the ground's, then `obstacle_slots` of what is nearest, nearest first; of the hips (4,),
        the knees (4,) and the trunk (6,) the nearest of everything. And whether any sphere touches an obstacle or wall.
    """
    radii = column(RADII, point[0])
    ground = (ground_plane(scene.terrain, point))
    nothing = Planes(jp.full_like(point[0], FAR), tuple(jp.zeros_like(c) for c in point))  # type: ignore[arg-type]
    nearest: tuple[Planes, ...] = (nothing,) * obstacle_slots
    hit = jp.zeros(point[0].shape, bool)
    for plane, solid in _candidates(scene, point):
        hit = hit | ((plane.distance < radii) & solid)
        nearest = (_insert(nearest, plane))
    surface = lambda plane: plane._replace(distance=plane.distance - radii)  # noqa: E731
    part = lambda plane, a, b: jax.tree.map(lambda x: x[a:b], surface(plane))  # noqa: E731
    single = (_closer(nearest[0], ground, nearest[0].distance < ground.distance))
    feet = tuple(part(plane, 0, LEGS) for plane in (ground, *nearest))
    others = [part(single, a, b) for a, b in ((LEGS, 2 * LEGS), (2 * LEGS, 3 * LEGS), (3 * LEGS, None))]
    return (feet, *others), jp.any(hit, axis=0)
