"""Which of the robot's spheres touch the world: our slots against C MuJoCo's contacts in the full scene."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics import collision, kinematics
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import Task, get_task
from tests.known_robots import A1
from tests.quick import QUICKLY

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

POSES = 200
MARGIN = 2e-4  # m: closer calls than this may differ by rounding


def _poses(scene) -> np.ndarray:
    """(POSES, 19) crouching, tilted robots beside obstacles, or on the course where there are none."""
    rng = np.random.default_rng(2)
    shapes = scene.cylinders if scene.cylinders.count else scene.boxes
    centres = np.array(shapes.center)[: max(1, min(shapes.count, 20))] if shapes.count else np.zeros((1, 3))
    # x, y = an obstacle's centre +U(-0.7, 0.7) m; height above the ground +U(0.1, 0.3) m
    xy = centres[rng.integers(len(centres), size=POSES), :2] + rng.uniform(-0.7, 0.7, (POSES, 2))
    ground = np.array(jax.vmap(lambda x, y: ground_height(scene, x, y))(*jp.array(xy.T)))
    quat = rng.normal(size=(POSES, 4)) * 0.15 + [1, 0, 0, 0]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    angles = np.array(A1.default_pose) + 0.3 * rng.normal(size=(POSES, 12))
    height = ground + rng.uniform(0.1, 0.3, POSES)
    return np.concatenate([xy, height[:, None], quat, angles], axis=1).astype(np.float32)


def _near(scene, qpos: np.ndarray) -> collision.Candidates:
    """What is near to the robot in each of its poses, (..., POSES)."""
    pick = lambda q: collision.broadphase(scene.replace(terrain=None), A1, q, PhysicsConfig())  # noqa: E731
    near = jax.tree.map(lambda x: jp.moveaxis(x, 0, -1), jax.jit(jax.vmap(pick))(jp.array(qpos)))
    spread = lambda x: jp.broadcast_to(x, (POSES, *x.shape))  # noqa: E731
    return near.replace(terrain=jax.tree.map(spread, scene.terrain))


@functools.partial(jax.jit, static_argnames="obstacle_slots")
def _held(
    near: collision.Candidates, qpos: jax.Array, always: jax.Array, obstacle_slots: int
) -> tuple[jax.Array, jax.Array]:
    """(POSES, 22) each sphere's smallest distance to what its slots hold; (POSES,) whether obstacles are touched."""
    point = kinematics.sphere_centers(A1, qpos.T)
    held = collision.narrowphase(FusionBarrier(always), near, A1, point, obstacle_slots)
    feet, knees = (jp.min(jp.stack([p.distance for p in planes]), axis=0) for planes in (held.feet, held.knees))
    return jp.concatenate([feet, held.hips.distance, knees, held.calves.distance, held.trunk.distance]).T, held.hit


def _ours(task: Task, scene, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    distance, hit = _held(_near(scene, qpos), jp.array(qpos), jp.array(True), task.obstacle_slots)
    return np.array(distance), np.array(hit)


def _theirs(scene, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same from C MuJoCo's contacts: (POSES, 22) smallest distance, 1 where there is no contact."""
    model = scene_spec(scene, A1).compile()
    data = mujoco.MjData(model)
    spheres = {model.geom(name).id: i for i, name in enumerate(A1.spheres)}
    distance = np.ones((POSES, len(spheres)))
    for pose, row in zip(qpos, distance, strict=True):
        data.qpos[:19] = pose
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            for geom in (contact.geom1, contact.geom2):
                if geom in spheres:
                    row[spheres[geom]] = min(row[spheres[geom]], contact.dist)
    return distance, distance < 0


@pytest.mark.parametrize(("task", "agreement"), [("thin", 1.0), ("indoor", 1.0), ("stairs", 1.0), ("mountain", 0.97)])
def test_the_same_spheres_touch(task, agreement):
    spec = get_task(task)
    scene = jax.jit(spec.generate, compiler_options=QUICKLY)(jax.random.PRNGKey(3))
    qpos = _poses(scene)
    ours, _ = _ours(spec, scene, qpos)
    theirs, touching = _theirs(scene, qpos)
    clear = (np.abs(ours) > MARGIN) & (np.abs(theirs) > MARGIN)
    same = ((ours < 0) == touching)[clear]
    assert touching.any(axis=0)[:4].all() and 0.02 < touching.mean() < 0.9  # both kinds are there, in every foot
    assert same.mean() >= agreement, f"{same.mean():.4f}"


def test_a_hit_is_a_contact_with_an_obstacle():
    """In `indoor` contacts above the ground's are with obstacles and walls; C's geoms tell which they are."""
    spec = get_task("indoor")
    scene = jax.jit(spec.generate, compiler_options=QUICKLY)(jax.random.PRNGKey(4))
    qpos = _poses(scene)
    qpos[:, 2] += 0.5  # off the ground, beside the obstacles
    ours, hit = _ours(spec, scene, qpos)
    theirs, touching = _theirs(scene, qpos)
    clear = (np.abs(ours) > MARGIN).all(axis=1) & (np.abs(theirs) > MARGIN).all(axis=1)
    assert 0.1 < hit.mean() < 0.9
    np.testing.assert_array_equal(hit[clear], touching.any(axis=1)[clear])
