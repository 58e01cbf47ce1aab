"""Depth images against C MuJoCo's mj_multiRay on the full scene, for random scenes of every task and random poses.

Silhouettes are left aside: there, a pixel may read the surface on either side. A pixel belongs to one if, in the
reference's 3 × 3 pixels around it, the depth departs by more than JUMP from what the surface in front of the
camera would continue to. (Inverse depth is linear over the image of a plane, so its second difference tells a break
from a slant: the level ground a pixel farther up may be metres away.)
"""

from __future__ import annotations

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.depth import camera, reference
from loco_mjx.depth.render import render
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.surface import ground
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import Scene

CONFIG = DepthConfig()
SCENES = 20
JUMP = 0.5  # m
SHARE = 0.99  # of the pixels, within the tolerance
COURSE = (-1.0, 12.0)  # m


def silhouettes(depth: np.ndarray) -> np.ndarray:
    """Flags of an image's pixels next to a break in depth."""
    inverse = np.pad(1.0 / depth, 1, mode="edge")
    breaks = np.zeros(depth.shape, bool)
    height, width = depth.shape
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        before = inverse[1 - i : 1 - i + height, 1 - j : 1 - j + width]
        after = inverse[1 + i : 1 + i + height, 1 + j : 1 + j + width]
        departure = np.abs(before + after - 2.0 / depth) * depth**2
        departure[[0, -1] if i else []] = 0.0
        departure[:, [0, -1] if j else []] = 0.0
        breaks |= departure > JUMP
    padded = np.pad(breaks, 1)
    return np.max([padded[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)


def draw_pose(key: jax.Array, scene: Scene) -> jax.Array:
    """(7,) a base pose above the ground, tilted, somewhere along the course."""
    key_place, key_height, key_angles = jax.random.split(key, 3)
    low, high = jp.array([COURSE[0], -1.5]), jp.array([COURSE[1], 1.5])
    if scene.terrain is not None:
        high = jp.array([min(COURSE[1], scene.terrain.origin[0] + 15.0), 1.5])
    place = jax.random.uniform(key_place, (2,), minval=low, maxval=high)  # (x, y) = +U(low, high) m
    height = jax.random.uniform(key_height, minval=0.2, maxval=0.45)  # above the ground = +U(0.2, 0.45) m
    # roll, pitch = +U(-0.3, 0.3), yaw = +U(-0.8, 0.8) rad
    half = 0.5 * jax.random.uniform(key_angles, (3,), minval=-1.0) * jp.array([0.3, 0.3, 0.8])
    (cr, cp, cy), (sr, sp, sy) = jp.cos(half), jp.sin(half)
    quat = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return jp.stack([*place, ground(scene.terrain, *place)[0] + height, *quat])


def is_clear(scene: Scene, pose: jax.Array) -> jax.Array:
    """Whether the camera is outside every shape and above the ground: inside, C MuJoCo reads the way out."""
    origin, _ = camera.pose(pose)
    boxes, balls, trunks = scene.boxes, scene.spheres, scene.cylinders
    away = origin - boxes.center
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    own = jp.stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]], axis=1)
    clear = jp.all(jp.any(jp.abs(own) > boxes.half + 0.02, axis=1))
    clear &= jp.all(jp.sum((origin - balls.center) ** 2, axis=1) > (balls.radius + 0.02) ** 2)
    clear &= jp.all(jp.sum((origin - trunks.center)[:, :2] ** 2, axis=1) > (trunks.radius + 0.02) ** 2)
    return clear & (origin[2] > ground(scene.terrain, origin[0], origin[1])[0] + 0.03)


def draw_clear_pose(key: jax.Array, scene: Scene) -> jax.Array:
    """The first clear pose of 32."""
    poses = jax.vmap(lambda key: draw_pose(key, scene))(jax.random.split(key, 32))
    return poses[jp.argmax(jax.vmap(lambda pose: is_clear(scene, pose))(poses))]


def expected(scene: Scene, pose: np.ndarray) -> np.ndarray:
    """C MuJoCo's image of one scene."""
    model = scene_spec(scene).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return reference.cast(model, data, pose, CONFIG)


@pytest.mark.parametrize("task", TASKS)
def test_depth_is_mj_multi_rays(task: str) -> None:
    keys = jax.random.split(jax.random.PRNGKey(5), SCENES)

    def one(key: jax.Array) -> tuple[Scene, jax.Array, jax.Array, jax.Array]:
        key_scene, key_pose = jax.random.split(key)
        scene = TASKS[task].generate(key_scene)
        pose = draw_clear_pose(key_pose, scene)
        return scene, pose, is_clear(scene, pose), render(scene, pose, CONFIG)

    scenes, poses, clear, images = jax.jit(jax.vmap(one))(keys)
    assert bool(jp.all(clear))
    tolerance = 0.01 if scenes.terrain is None else 0.05
    aside, close, seen = [], [], 0
    for i in range(SCENES):
        depth = expected(jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), scenes), np.asarray(poses[i]))
        aside.append(silhouettes(depth))
        close.append(np.abs(np.asarray(images[i]) - depth) <= tolerance)
        seen += (depth < CONFIG.far).mean() / SCENES
    aside, close = np.array(aside), np.array(close)
    print(
        f"{task}: {100 * close[~aside].mean():.3f} % within {tolerance} m aside from {100 * aside.mean():.1f} % ",
        f"silhouettes, {100 * close.mean():.3f} % of all; {100 * seen:.0f} % of the pixels see something",
    )
    assert seen > 0.2 and aside.mean() < 0.25
    assert close[~aside].mean() >= SHARE
    for i in range(SCENES):
        assert close[i][~aside[i]].mean() >= SHARE - 0.02


def test_reference_reads_known_distances() -> None:
    """The oracle itself: a wall 2 m ahead of the camera on the ground 0.5 m below it."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="1 1 1" group="2"/>
        <geom type="box" pos="2.7309 0 1" size="0.5 9 9" group="2"/>
        <geom type="box" pos="1 0 1" size="0.1 9 9" group="3"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = reference.cast(model, data, np.array([0.0, 0, 0.5, 1, 0, 0, 0]), CONFIG)
    np.testing.assert_allclose(image[:40], 2.0, atol=1e-9)
    np.testing.assert_allclose(image[63], 0.879772, rtol=1e-5)  # 0.5 / 0.568329
    np.testing.assert_allclose(reference.directions(CONFIG).T[1:], camera.rays(CONFIG), atol=1e-6)


def test_silhouettes_are_breaks_and_not_slants() -> None:
    up = camera.rays(CONFIG)[1].reshape(64, 64)
    ground_only = np.clip(-0.3 / np.minimum(up, -1e-9), CONFIG.near, CONFIG.far)
    assert not silhouettes(ground_only)[36:].any()
    step = np.full((64, 64), 3.0)
    step[:, 30:] = 5.0
    np.testing.assert_array_equal(np.flatnonzero(silhouettes(step).any(axis=0)), [28, 29, 30, 31])
