"""Depth images against C MuJoCo's mj_multiRay on the full scene, for random scenes of every task and random poses.

No pixel is left aside, not even along silhouettes, where a ray a hair's breadth off reads another surface.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx import rotations
from loco_mjx.config import DepthConfig
from loco_mjx.depth import c_mujoco, camera
from loco_mjx.depth.render import render
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.surface import ground
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import Scene
from tests.known_robots import A1
from tests.quick import QUICKLY

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

CONFIG = DepthConfig()
SCENES = 20
COURSE = (-1.0, 32.0)  # m


def draw_pose(rng: np.random.Generator, scene: Scene) -> np.ndarray:
    """(7,) a base pose above the ground, tilted, somewhere along the course."""
    end = COURSE[1] if scene.terrain is None else min(COURSE[1], scene.terrain.origin[0] + 15.0)
    place = rng.uniform((COURSE[0], -1.5), (end, 1.5))  # (x, y) = +U(low, high) m
    height = rng.uniform(0.2, 0.45)  # above the ground = +U(0.2, 0.45) m
    # roll, pitch = +U(-0.3, 0.3), yaw = +U(-0.8, 0.8) rad
    roll, pitch, yaw = rng.uniform(-1.0, 1.0, 3) * [0.3, 0.3, 0.8]
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, (yaw, pitch, roll), "zyx")
    return np.array([*place, under(scene, *place) + height, *quat], np.float32)


def under(scene: Scene, x: float, y: float) -> float:
    """Height of the ground, m."""
    return 0.0 if scene.terrain is None else float(GROUND(scene.terrain, jp.float32(x), jp.float32(y))[0])


GROUND = jax.jit(ground)


def is_clear(scene: Scene, pose: np.ndarray) -> bool:
    """Whether the camera is outside every shape and above the ground: inside, C MuJoCo reads the way out."""
    origin = pose[:3] + rotations.matrix(pose[3:], np) @ A1.camera
    boxes, balls, trunks = scene.boxes, scene.spheres, scene.cylinders
    away = origin - boxes.center
    cos, sin = np.cos(boxes.yaw), np.sin(boxes.yaw)
    own = np.stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]], axis=1)
    clear = np.all(np.any(np.abs(own) > boxes.half + 0.02, axis=1))
    clear &= np.all(np.sum((origin - balls.center) ** 2, axis=1) > (balls.radius + 0.02) ** 2)
    clear &= np.all(np.sum((origin - trunks.center)[:, :2] ** 2, axis=1) > (trunks.radius + 0.02) ** 2)
    return bool(clear) and origin[2] > under(scene, *origin[:2]) + 0.03


def draw_clear_pose(rng: np.random.Generator, scene: Scene) -> np.ndarray:
    """The first clear pose of 32."""
    found = next((pose for pose in (draw_pose(rng, scene) for _ in range(32)) if is_clear(scene, pose)), None)
    assert found is not None, "no pose of 32 is clear"
    return found


def expected(scene: Scene, pose: np.ndarray) -> np.ndarray:
    """C MuJoCo's image of one scene."""
    model = scene_spec(scene, A1).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return c_mujoco.cast(model, data, pose, A1.camera, CONFIG)


@pytest.mark.parametrize("task", TASKS)
def test_depth_is_mj_multi_rays(task: str) -> None:
    generate, rng = jax.jit(TASKS[task].generate, compiler_options=QUICKLY), np.random.default_rng(5)
    scenes = [jax.tree.map(np.asarray, generate(key)) for key in jax.random.split(jax.random.PRNGKey(5), SCENES)]
    poses = [draw_clear_pose(rng, scene) for scene in scenes]
    batch = jax.tree.map(lambda *leaves: np.stack(leaves), *scenes)
    images = jax.jit(jax.vmap(lambda scene, pose: render(scene, pose, A1.camera, CONFIG)))(batch, np.stack(poses))
    depths = np.array([expected(scene, pose) for scene, pose in zip(scenes, poses, strict=True)])
    terrain = scenes[0].terrain
    tolerance = 0.01 if terrain is None else 0.05
    close = (np.abs(np.asarray(images) - depths) <= tolerance).mean(axis=(1, 2))
    print(f"{task}: {100 * close.mean():.3f} % within {tolerance} m, {100 * close.min():.2f} % in the worst frame")
    assert 0.2 < (depths < CONFIG.far).mean() < 0.99  # there is something to see, and sky
    assert close.mean() >= (0.9999 if terrain is None else 0.99)
    assert close.min() >= (0.999 if terrain is None else 0.97)


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
