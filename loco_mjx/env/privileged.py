"""What only a simulator knows: the observation of a teacher and of a critic, never of a policy that is deployed.

Lengths are scaled to order 1, so that nothing has to be normalised. The heading frame is the base's, turned by its yaw
alone.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import rotations
from loco_mjx.scene import surface
from loco_mjx.scene.types import COLLISION_MARGIN, STEP, Scene

SCAN_X = np.linspace(-0.4, 1.6, 11)  # m, ahead of the base
SCAN_Y = np.linspace(-0.6, 0.6, 7)  # m, to its left
RAY_ANGLES = np.radians(np.linspace(-120.0, 120.0, 31))  # from the heading
REACH = 5.0  # m, of the rays
SPHERES = 4  # the nearest of those still to be collected
SIZE = SCAN_X.size * SCAN_Y.size + 2 * RAY_ANGLES.size + 3 * SPHERES + 13


def observe(scene: Scene, stand_height: float, qpos: jax.Array, qvel: jax.Array) -> jax.Array:
    """The privileged observation of one environment.

    Args:
        scene: its world.
        stand_height: of the robot's base above the ground, m.
        qpos: (19,) base position, quaternion, joint angles.
        qvel: (18,) base velocity (world), angular velocity (body), joint speeds.

    Returns:
        (SIZE,): heights on a grid in the heading frame relative to the base (11 × 7, times 4), level rays' closeness
        (31, from 1 at 0 m to 0 at 5 m) and speed of what they hit toward the robot (31, m/s), the nearest spheres
        (4 × 3: direction and closeness), heading (cos, sin), direction and distance of the goal (3), velocity of
        the base in the heading frame (3), its angular velocity (3), height above the ground (1), place across (1).
    """
    yaw = rotations.yaw(qpos[3:7], jp)
    cos, sin = jp.cos(yaw), jp.sin(yaw)
    closeness, closing = _rays(scene, qpos[:2], yaw)
    height = qpos[2] - surface.ground_height(scene, qpos[0], qpos[1])
    parts = [
        4.0 * jp.clip(_scan(scene, qpos[:3], cos, sin) + stand_height, -1.0, 1.0),
        closeness,
        closing,
        _spheres(scene, qpos[:2], cos, sin),
        jp.stack([cos, sin]),
        _goal(scene.goal, qpos[:3], cos, sin),
        jp.stack([cos * qvel[0] + sin * qvel[1], cos * qvel[1] - sin * qvel[0], qvel[2]]),
        0.3 * qvel[3:6],
        jp.stack([4.0 * (height - stand_height), jp.clip(qpos[1], -4.0, 4.0)]),
    ]
    return jp.clip(jp.concatenate(parts), -5.0, 5.0)


def _scan(scene: Scene, base: jax.Array, cos: jax.Array, sin: jax.Array) -> jax.Array:
    """(77,) ground heights relative to the base, m."""
    ahead, aside = (jp.asarray(grid.ravel(), jp.float32) for grid in np.meshgrid(SCAN_X, SCAN_Y, indexing="ij"))
    x, y = base[0] + cos * ahead - sin * aside, base[1] + sin * ahead + cos * aside
    return jax.vmap(lambda x, y: surface.ground_height(scene, x, y))(x, y) - base[2]


def _goal(goal: jax.Array, base: jax.Array, cos: jax.Array, sin: jax.Array) -> jax.Array:
    """(3,) level direction to the goal in the heading frame, and its distance over 10 m; zeros without a goal."""
    dx, dy, _ = goal - base
    distance = jp.maximum(jp.sqrt(dx * dx + dy * dy), 1e-3)
    found = jp.stack([(cos * dx + sin * dy) / distance, (cos * dy - sin * dx) / distance, distance / 10.0])
    return jp.where(jp.any(goal != 0.0), found, 0.0)


def _rays(scene: Scene, base: jax.Array, yaw: jax.Array) -> tuple[jax.Array, jax.Array]:
    """(31,) closeness of the collision surface of obstacles and walls along level rays, and its closing speed, m/s."""
    angles = yaw + jp.asarray(RAY_ANGLES, jp.float32)
    direction = jp.stack([jp.cos(angles), jp.sin(angles)])  # (2, rays)
    nearest = jp.full(angles.shape, REACH)
    closing = jp.zeros(angles.shape)
    boxes = scene.boxes
    if boxes.count:
        distance = _box_distances(scene, base, direction)  # (boxes, rays)
        hit = jp.argmin(distance, axis=0)
        nearest = jp.minimum(nearest, jp.min(distance, axis=0))
        toward = -jp.sum(boxes.velocity[hit].T * direction, axis=0)
        closing = jp.where(nearest < REACH, toward, 0.0)
    if scene.cylinders.count:
        trees = jp.min(_circle_distances(scene, base, direction), axis=0)
        closing = jp.where(trees < nearest, 0.0, closing)
        nearest = jp.minimum(nearest, trees)
    return 1.0 - nearest / REACH, closing


def _box_distances(scene: Scene, base: jax.Array, direction: jax.Array) -> jax.Array:
    """(boxes, rays) distances to boxes as high as the base that collide, m; REACH where there is none."""
    boxes = scene.boxes
    offset = base - boxes.center[:, :2]  # (boxes, 2)
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    start = (cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0])
    along = (
        cos[:, None] * direction[0] + sin[:, None] * direction[1],
        cos[:, None] * direction[1] - sin[:, None] * direction[0],
    )
    half = boxes.collision_half
    near, far = jp.zeros(along[0].shape), jp.full(along[0].shape, REACH)
    for axis in range(2):
        slope = jp.where(jp.abs(along[axis]) < 1e-6, 1e-6, along[axis])
        first = (-half[:, axis, None] - start[axis][:, None]) / slope
        second = (half[:, axis, None] - start[axis][:, None]) / slope
        near = jp.maximum(near, jp.minimum(first, second))
        far = jp.minimum(far, jp.maximum(first, second))
    solid = (boxes.kind != STEP)[:, None]
    return jp.where((near < far) & solid, near, REACH)


def _circle_distances(scene: Scene, base: jax.Array, direction: jax.Array) -> jax.Array:
    """(cylinders, rays) distances to the circles that trees collide with, m; REACH where there is none."""
    offset = base - scene.cylinders.center[:, :2]
    radius = scene.cylinders.radius + COLLISION_MARGIN
    ahead = -(offset @ direction)  # (cylinders, rays)
    reach = ahead**2 - (jp.sum(offset**2, axis=1) - radius**2)[:, None]
    distance = ahead - jp.sqrt(jp.maximum(reach, 0.0))
    return jp.where((reach > 0) & (ahead > 0), jp.clip(distance, 0.0, REACH), REACH)


def _spheres(scene: Scene, base: jax.Array, cos: jax.Array, sin: jax.Array) -> jax.Array:
    """(12,) direction in the heading frame and closeness of the nearest spheres that are still to be collected."""
    spheres = scene.spheres
    if not spheres.count:
        return jp.zeros(3 * SPHERES)
    offset = spheres.center[:, :2] - base
    distance = jp.sqrt(jp.maximum(jp.sum(offset**2, axis=1), 1e-6))
    distance = jp.where(spheres.reward & ~spheres.collected, distance, REACH)
    shown = min(SPHERES, spheres.count)
    _, order = jax.lax.top_k(-distance, shown)
    near, (dx, dy) = distance[order], offset[order].T
    closeness = jp.maximum(1.0 - near / REACH, 0.0)
    seen = closeness > 0
    turned = [jp.where(seen, c / near, 0.0) for c in (cos * dx + sin * dy, cos * dy - sin * dx)]
    found = jp.stack([*turned, closeness], axis=1)
    return jp.concatenate([found, jp.zeros((SPHERES - shown, 3))]).ravel()
