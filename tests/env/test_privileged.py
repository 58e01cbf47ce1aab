"""What a teacher sees, on scenes made by hand."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import EnvConfig, ObservationConfig
from loco_mjx.env import privileged
from loco_mjx.scene.parts import make_boxes, make_scene
from loco_mjx.scene.types import STEP, Cylinders, Spheres, Terrain
from tests.known_robots import A1

POINTS, RAYS = privileged.SCAN_X.size * privileged.SCAN_Y.size, privileged.RAY_ANGLES.size
AHEAD = RAYS // 2  # the ray along the heading
_observe = jax.jit(lambda scene, qpos, qvel: privileged.observe(scene, A1.stand_height, qpos, qvel))


def _pose(x=0.0, y=0.0, z=A1.stand_height, yaw=0.0):
    turned = jp.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    return jp.concatenate([jp.array([x, y, z]), turned, jp.array(A1.default_pose)])


def _parts(scene, pose, velocity=(0.0,) * 6):
    """The observation's parts by name."""
    seen = np.asarray(_observe(scene, pose, jp.concatenate([jp.array(velocity), jp.zeros(12)])))
    sizes = {"scan": POINTS, "closeness": RAYS, "closing": RAYS, "spheres": 3 * privileged.SPHERES, "heading": 2}
    sizes |= {"goal": 3, "velocity": 3, "turning": 3, "height": 1, "across": 1}
    assert seen.shape == (sum(sizes.values()),) == (privileged.SIZE,)
    ends = np.cumsum(list(sizes.values()))
    return {name: seen[end - size : end] for (name, size), end in zip(sizes.items(), ends, strict=True)}


def test_standing_alone_on_the_plane_all_is_zero_but_the_heading():
    parts = _parts(make_scene(), _pose())
    np.testing.assert_allclose(parts.pop("heading"), [1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.concatenate(list(parts.values())), 0.0, atol=1e-5)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, -2.0])
def test_the_scan_turns_with_the_heading(yaw):
    # Ground that rises 0.1 m per metre along x, heights exact on the triangles.
    ramp = Terrain(0.1 * jp.arange(-50, 51)[:, None] * 0.1 * jp.ones((1, 101)), (-5.0, -5.0), 0.1)
    scan = _parts(make_scene(ground_field=ramp), _pose(yaw=yaw))["scan"].reshape(11, 7)
    ahead, aside = np.meshgrid(privileged.SCAN_X, privileged.SCAN_Y, indexing="ij")
    expected = 4 * 0.1 * (np.cos(yaw) * ahead - np.sin(yaw) * aside)
    np.testing.assert_allclose(scan, expected, atol=1e-4)


def test_steps_are_ground_and_do_not_stop_rays():
    step = make_boxes(jp.array([[1.2, 0.0, 0.05]]), jp.array([0.5, 5.0, 0.05]), STEP)
    parts = _parts(make_scene(step), _pose())
    expected = np.where(np.abs(privileged.SCAN_X - 1.2) <= 0.5, 0.4, 0.0)
    np.testing.assert_allclose(parts["scan"].reshape(11, 7), np.tile(expected[:, None], 7), atol=1e-5)
    np.testing.assert_allclose(parts["closeness"], 0.0, atol=1e-6)


def test_rays_end_on_the_collision_box_and_feel_it_come():
    box = make_boxes(jp.array([[2.0, 0.0, 0.5]]), jp.array([0.1, 0.1, 0.5]), velocity=jp.array([[-0.5, 0.2]]))
    parts = _parts(make_scene(box), _pose())
    # 2 m less the half extent and the collision margin.
    assert parts["closeness"][AHEAD] == pytest.approx(1 - 1.85 / privileged.REACH, abs=1e-5)
    assert parts["closing"][AHEAD] == pytest.approx(0.5, abs=1e-6)
    assert parts["closeness"][AHEAD + 8] == 0 == parts["closing"][AHEAD + 8]
    # Turned a quarter, a box half as far away aside is ahead.
    turned = _parts(make_scene(dataclasses.replace(box, center=jp.array([[0.0, 1.0, 0.5]]))), _pose(yaw=np.pi / 2))
    assert turned["closeness"][AHEAD] == pytest.approx(1 - 0.85 / privileged.REACH, abs=1e-5)


def test_rays_see_a_turned_box_and_the_nearer_tree():
    yaw = jp.array([np.pi / 4])
    box = make_boxes(jp.array([[3.0, 0.0, 0.5]]), jp.array([0.45, 0.45, 0.5]), yaw=yaw)
    behind = _parts(make_scene(box), _pose())["closeness"][AHEAD]
    assert behind == pytest.approx(1 - (3 - 0.5 * np.sqrt(2)) / privileged.REACH, abs=1e-4)
    tree = Cylinders(jp.array([[1.5, 0.0, 1.0]]), jp.array([0.2]), jp.array([1.0]))
    seen = _parts(make_scene(box, cylinders=tree), _pose())
    assert seen["closeness"][AHEAD] == pytest.approx(1 - 1.25 / privileged.REACH, abs=1e-5)


def test_spheres_nearest_first_and_not_those_collected():
    center = jp.array([[2.0, 0, 0.3], [0, 1.0, 0.3], [0.5, 0, 0.3], [0, -0.6, 0.3]])
    spheres = Spheres(center, jp.full(4, 0.1), jp.array([False, False, True, False]), jp.array([1, 1, 1, 0], bool))
    found = _parts(make_scene(spheres=spheres), _pose())["spheres"].reshape(4, 3)
    np.testing.assert_allclose(found, [[0, 1, 0.8], [1, 0, 0.6], [0, 0, 0], [0, 0, 0]], atol=1e-6)


def test_velocity_and_goal_are_in_the_heading_frame():
    scene = make_scene(goal=jp.array([0.0, 3.0, 1.0]))
    parts = _parts(scene, _pose(yaw=np.pi / 2), (0.0, 0.8, 0.1, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(parts["velocity"], [0.8, 0.0, 0.1], atol=1e-6)
    np.testing.assert_allclose(parts["turning"], [0.0, 0.0, 0.3], atol=1e-6)
    np.testing.assert_allclose(parts["goal"], [1.0, 0.0, 0.3], atol=1e-6)
    assert _parts(make_scene(), _pose(y=1.5, z=A1.stand_height + 0.1))["across"] == pytest.approx(1.5)


def test_the_environment_has_it_where_it_is_asked_for():
    import loco_mjx

    plain = ObservationConfig()
    depth = dataclasses.replace(plain.depth, enabled=False)
    config = EnvConfig(observation=dataclasses.replace(plain, depth=depth, privileged=True))
    env = loco_mjx.make_env("thin", config)
    state = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
    assert {name: x.shape for name, x in state.obs.items()} == env.observation_size
    assert env.observation_size["privileged"] == (privileged.SIZE,)
