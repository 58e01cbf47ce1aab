"""Casts one ray per pixel at a scene: what can be in view is gathered first, then tested pixel by pixel.

Loops run over what is in view, however much that is, so a crowded frame takes longer and is as exact as any.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import DepthConfig
from loco_mjx.depth import camera, heightfield, primitives
from loco_mjx.depth.primitives import Rays
from loco_mjx.robots.robot import Vector3
from loco_mjx.scene.types import Boxes, Scene, Terrain

BLOCK = 4  # primitives tested in one pass over the image


@struct.dataclass
class Shapes:
    """Primitives of one kind, those in view first and the others void.

    Attributes:
        params: (passes, block, n) the parameters that the tests in primitives.py read.
        count: int32 scalar, how many are in view.
    """

    params: jax.Array
    count: jax.Array


@struct.dataclass
class CulledScene:
    """A scene seen from one pose: all that the pixels need.

    Attributes:
        origin: (3,) camera in the world, m.
        rotation: (3, 3) columns forward, left, up.
        boxes: boxes along the world's axes.
        turned_boxes: boxes with a yaw.
        spheres: spheres not collected.
        cylinders: cylinders.
        terrain: the heightfield, or None for the plane z = 0.
    """

    origin: jax.Array
    rotation: jax.Array
    boxes: Shapes
    turned_boxes: Shapes
    spheres: Shapes
    cylinders: Shapes
    terrain: Terrain | None


def _order(in_view: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Indices (N,) of (N,) flags that are set, as they come, then N; and how many are set.

    Not a sort, whose cost grows with the scene's length. There are as many places as flags: none is ever left out.
    """
    number = in_view.shape[0]
    place = jp.cumsum(in_view, dtype=jp.int32)
    order = jp.full((number,), number, jp.int32)
    order = order.at[jp.where(in_view, place - 1, number)].set(jp.arange(number, dtype=jp.int32), mode="drop")
    return order, jp.sum(in_view, dtype=jp.int32)


def gather(in_view: jax.Array, center: jax.Array, *sizes: jax.Array) -> Shapes:
    """Shapes from (N,) flags, (N, 3) centres and parameters of shape (N,) or (N, n).

    A negative size is void: no ray hits it.
    """
    number = in_view.shape[0]
    columns = [size.reshape(number, -1) for size in sizes] if number else []
    params = jp.concatenate([center, *columns], axis=1)
    void = jp.where(jp.arange(params.shape[1]) < 3, 0.0, -1.0)
    block = max(1, min(BLOCK, number))
    order, count = _order(in_view)
    order = jp.concatenate([order, jp.full((-number % block,), number, jp.int32)])
    params = jp.concatenate([params, void[None]]).at[order].get(mode="promise_in_bounds")
    return Shapes(params.reshape(-1, block, void.size), count)


def _gather_boxes(planes: tuple[jax.Array, jax.Array], boxes: Boxes, origin: jax.Array) -> tuple[Shapes, Shapes]:
    """Boxes along the world's axes, which need no division per box and pixel, and the turned ones."""
    center = boxes.center - origin
    in_view = primitives.boxes_in_view(planes, boxes, center)
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    x, y, z = center.T
    own = jp.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
    turned = boxes.yaw != 0.0
    return gather(in_view & ~turned, center, boxes.half), gather(in_view & turned, own, boxes.half, cos, sin)


def cull(scene: Scene, qpos: jax.Array, mount: Vector3, config: DepthConfig) -> CulledScene:
    """Frustum culling: gathers what a camera at ``mount`` in the base's frame can see; ``qpos`` is (7 or more,)."""
    origin, rotation = camera.pose(qpos, mount)
    planes = primitives.frustum(rotation, config)
    boxes, turned_boxes = _gather_boxes(planes, scene.boxes, origin)
    spheres, cylinders = scene.spheres, scene.cylinders
    center = spheres.center - origin
    balls = gather(primitives.spheres_in_view(planes, spheres, center), center, spheres.radius)
    center = cylinders.center - origin
    in_view = primitives.cylinders_in_view(planes, cylinders, center)
    trunks = gather(in_view, center, cylinders.radius, cylinders.half_height)
    return CulledScene(origin, rotation, boxes, turned_boxes, balls, trunks, scene.terrain)


def _nearest_hit(
    test: Callable[[jax.Array, Rays, jax.Array], jax.Array], shapes: Shapes, rays: Rays, depth: jax.Array
) -> jax.Array:
    """The nearer of ``depth`` (pixels,) and all shapes."""

    def one_pass(index: jax.Array, depth: jax.Array) -> jax.Array:
        for params in shapes.params[index]:
            depth = test(depth, rays, params)
        return depth

    passes, block, _ = shapes.params.shape
    if passes == 0:
        return depth
    return jax.lax.fori_loop(0, (shapes.count + block - 1) // block, one_pass, depth)


def cast_rays(view: CulledScene, config: DepthConfig) -> jax.Array:
    """The (height, width) image of a view: planar depth in metres, clipped to [near, far]."""
    left, up = camera.rays(config)
    rays = primitives.make_rays(view.rotation, jp.asarray(left), jp.asarray(up))
    if view.terrain is None:
        depth = primitives.plane(rays, view.origin[2], config.far)
    else:
        depth = heightfield.cast(view.terrain, view.origin, view.rotation, rays, config)
    depth = _nearest_hit(primitives.upright_box, view.boxes, rays, depth)
    depth = _nearest_hit(primitives.turned_box, view.turned_boxes, rays, depth)
    depth = _nearest_hit(primitives.sphere, view.spheres, rays, depth)
    depth = _nearest_hit(primitives.cylinder, view.cylinders, rays, depth)
    return jp.clip(depth, config.near, config.far).reshape(config.height, config.width)


def _one_at_a_time_on_cpu(function: Callable[[CulledScene], jax.Array]) -> Callable[[CulledScene], jax.Array]:
    """``function``, which under ``jax.vmap`` runs frame after frame on a CPU, and all frames at once elsewhere.

    One frame's vectors stay in a core's cache, a batch's do not, and a frame's loops end when it is done, a batch's
    when the last of its frames is.
    """
    mapped = jax.custom_batching.custom_vmap(function)

    @mapped.def_vmap
    def rule(axis_size: int, in_batched: tuple[CulledScene], view: CulledScene) -> tuple[jax.Array, bool]:
        leaves, tree = jax.tree.flatten(view)
        batched = jax.tree.leaves(in_batched)
        moving = [leaf for leaf, moves in zip(leaves, batched, strict=True) if moves]

        def whole(moving: list[jax.Array]) -> CulledScene:
            rest = iter(moving)
            return jax.tree.unflatten(
                tree, [next(rest) if moves else leaf for leaf, moves in zip(leaves, batched, strict=True)]
            )

        def in_turn(moving: list[jax.Array]) -> jax.Array:
            return jax.lax.map(lambda one: mapped(whole(one)), moving)

        def together(moving: list[jax.Array]) -> jax.Array:
            return jax.vmap(lambda one: function(whole(one)))(moving)

        return jax.lax.platform_dependent(moving, cpu=in_turn, default=together), True

    return mapped


def render(scene: Scene, qpos: jax.Array, mount: Vector3, config: DepthConfig) -> jax.Array:
    """The depth image seen from a robot's base; write it for one environment and ``jax.vmap`` it.

    Args:
        scene: one environment's world; visual extents are what is seen, the robot itself is not.
        qpos: (7 or more,) base position, base quaternion (w, x, y, z), and whatever follows.
        mount: the camera in the base's frame, m; it looks along the base's x.
        config: size, field of view and clips of the image.

    Returns:
        (height, width) float32 planar depth in metres, clipped to [near, far]; row 0 is the top, column 0 the left;
        rays that hit nothing read ``far``.
    """
    return _one_at_a_time_on_cpu(partial(cast_rays, config=config))(cull(scene, qpos, mount, config))
