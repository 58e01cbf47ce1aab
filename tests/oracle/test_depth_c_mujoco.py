"""Depth images against C MuJoCo's mj_multiRay on the full scene, for random scenes of every task and random poses.

No pixel is left aside, not even along silhouettes, where a ray a hair's breadth off reads another surface.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.depth import c_mujoco, camera
from loco_mjx.depth.render import render
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.surface import ground
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import Scene
from tests.known_robots import A1

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

CONFIG = DepthConfig()
SCENES = 20
COURSE = (-1.0, 32.0)  # m


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
    origin, _ = camera.pose(pose, A1.camera)
    boxes, balls, trunks = scene.boxes, scene.spheres, scene.cylinders
    away = origin - boxes.center
    cos, sin = jp.cos(boxes.yaw), jp.sin(boxes.yaw)
    own = jp.stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]], axis=1)
    clear = jp.all(jp.any(jp.abs(own) > boxes.half + 0.02, axis=1))
    clear &= jp.all(jp.sum((origin - balls.center) ** 2, axis=1) > (balls.radius + 0.02) ** 2)
    clear &= jp.all(jp.sum((origin - trunks.center)[:, :2] ** 2, axis=1) > (trunks.radius + 0.02) ** 2)
    return clear & (origin[2] > ground(scene.terrain, origin[0], origin[1])[0] + 0.03)


# What is not under test is compiled in half the time.
QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


def draw_clear_pose(key: jax.Array, scene: Scene) -> jax.Array:
    """The first clear pose of 32."""
    poses = jax.vmap(lambda key: draw_pose(key, scene))(jax.random.split(key, 32))
    return poses[jp.argmax(jax.vmap(lambda pose: is_clear(scene, pose))(poses))]


def expected(scene: Scene, pose: np.ndarray) -> np.ndarray:
    """C MuJoCo's image of one scene."""
    model = scene_spec(scene, A1).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return c_mujoco.cast(model, data, pose, A1.camera, CONFIG)


@pytest.mark.parametrize("task", TASKS)
def test_depth_is_mj_multi_rays(task: str) -> None:
    keys = jax.random.split(jax.random.PRNGKey(5), SCENES)

    def one(key: jax.Array) -> tuple[Scene, jax.Array, jax.Array]:
        key_scene, key_pose = jax.random.split(key)
        scene = TASKS[task].generate(key_scene)
        pose = draw_clear_pose(key_pose, scene)
        return scene, pose, is_clear(scene, pose)

    scenes, poses, clear = jax.jit(jax.vmap(one), compiler_options=QUICKLY)(keys)
    images = jax.jit(jax.vmap(lambda scene, pose: render(scene, pose, A1.camera, CONFIG)))(scenes, poses)
    assert bool(jp.all(clear))
    rows, poses, images = range(SCENES), np.asarray(poses), np.asarray(images)
    depths = np.array([expected(jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), scenes), poses[i]) for i in rows])
    tolerance = 0.01 if scenes.terrain is None else 0.05
    close = (np.abs(images - depths) <= tolerance).mean(axis=(1, 2))
    print(f"{task}: {100 * close.mean():.3f} % within {tolerance} m, {100 * close.min():.2f} % in the worst frame")
    assert 0.2 < (depths < CONFIG.far).mean() < 0.99  # there is something to see, and sky
    assert close.mean() >= (0.9999 if scenes.terrain is None else 0.99)
    assert close.min() >= (0.999 if scenes.terrain is None else 0.97)


def test_reference_reads_known_distances() -> None:
    """The oracle itself: a wall 2 m ahead of the camera on the ground 0.5 m below it."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom type="plane" size="0 0 1" group="2"/>
        <geom type="box" pos="2.7309 0 1" size="0.5 9 9" group="2"/>
        <geom type="box" pos="1 0 1" size="0.1 9 9" group="3"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = c_mujoco.cast(model, data, np.array([0.0, 0, 0.5, 1, 0, 0, 0]), A1.camera, CONFIG)
    np.testing.assert_allclose(image[:40], 2.0, atol=1e-9)
    np.testing.assert_allclose(image[63], 0.879772, rtol=1e-5)  # 0.5 / 0.568329
    np.testing.assert_allclose(
        c_mujoco.directions(CONFIG.height, CONFIG.width, CONFIG.vertical_fov, CONFIG.horizontal_fov).T[1:],
        camera.rays(CONFIG),
        atol=1e-6,
    )
