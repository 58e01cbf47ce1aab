from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.robots import LEGS
from loco_mjx.scene.mjcf import KIND_NAMES, home_qpos, place_boxes, scene_spec, scene_xml
from loco_mjx.scene.motion import move
from loco_mjx.scene.surface import ground
from loco_mjx.scene.tasks import TASKS
from loco_mjx.scene.types import OBSTACLE, STEP
from tests.known_robots import A1
from tests.scene.scenes import one

SAMPLES = Path(__file__).resolve().parents[2] / "mjcf"
BOX, CYLINDER, SPHERE = (
    int(kind) for kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE)
)


@cache
def compiled(task: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(scene_xml(one(task), A1))


def at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def heights_below(model: mujoco.MjModel, points: np.ndarray) -> np.ndarray:
    """Of what the robot stands on (ground and contact geoms), by rays from above."""
    data = at_home(model)
    groups = np.array([0, 0, 1, 0, 0, 0], np.uint8)
    hit = np.zeros(1, np.int32)
    down = np.array([0.0, 0.0, -1.0])
    return np.array(
        [10 - mujoco.mj_ray(model, data, np.array([x, y, 10.0]), down, groups, 1, -1, hit) for x, y in points]
    )


@pytest.mark.parametrize("task", TASKS)
def test_boxes_are_geoms_to_see_and_larger_geoms_to_touch(task):
    scene, model = one(task), compiled(task)
    data = at_home(model)
    assert (model.geom_type == BOX)[model.geom_group == 2].sum() == scene.boxes.count
    assert (model.geom_type == BOX)[model.geom_group == 3].sum() == scene.boxes.count
    for i in range(scene.boxes.count):
        kind = int(scene.boxes.kind[i])
        name = f"{KIND_NAMES[kind]}_{i}"
        margin = 0.0 if kind == STEP else 0.05
        seen, contact = model.geom(name), model.geom(f"{name}_contact")
        cos, sin = np.cos(scene.boxes.yaw[i]), np.sin(scene.boxes.yaw[i])
        for geom, half in ((seen, scene.boxes.half[i]), (contact, scene.boxes.half[i] + [margin, margin, 0])):
            np.testing.assert_allclose(geom.size, half, atol=1e-4)
            np.testing.assert_allclose(data.geom_xpos[geom.id], scene.boxes.center[i], atol=1e-4)
            np.testing.assert_allclose(data.geom_xmat[geom.id], [cos, -sin, 0, sin, cos, 0, 0, 0, 1], atol=1e-5)
        assert (seen.group[0], seen.contype[0], seen.conaffinity[0]) == (2, 0, 0)
        assert (contact.group[0], contact.contype[0], contact.conaffinity[0]) == (3, 2, 1)


@pytest.mark.parametrize("task", ["thin-sphere", "mountain", "forest"])
def test_spheres_and_cylinders(task):
    scene, model = one(task), compiled(task)
    balls = [i for i in range(model.ngeom) if model.geom_group[i] == 2 and model.geom_type[i] == SPHERE]
    assert len(balls) == scene.spheres.count
    assert not model.geom_contype[balls].any() and not model.geom_conaffinity[balls].any()
    np.testing.assert_allclose(model.geom_pos[balls], scene.spheres.center, atol=1e-4)
    np.testing.assert_allclose(model.geom_size[balls, 0], scene.spheres.radius, atol=1e-5)
    for group, margin in ((2, 0.0), (3, 0.05)):
        trunks = [i for i in range(model.ngeom) if model.geom_group[i] == group and model.geom_type[i] == CYLINDER]
        np.testing.assert_allclose(model.geom_pos[trunks], scene.cylinders.center, atol=1e-4)
        np.testing.assert_allclose(model.geom_size[trunks, 0], scene.cylinders.radius + margin, atol=1e-5)
        np.testing.assert_allclose(model.geom_size[trunks, 1], scene.cylinders.half_height, atol=1e-5)


def test_the_goal_is_red_and_a_collected_sphere_is_gone():
    model = compiled("mountain")
    red, green, blue, alpha = model.mat_rgba[model.geom("goal").matid[0]]
    assert red > 3 * max(green, blue) and alpha == 1.0
    scene = one("thin-sphere")
    gone = replace(scene, spheres=replace(scene.spheres, collected=np.arange(scene.spheres.count) == 7))
    model = scene_spec(gone, A1).compile()
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "sphere_7") == -1
    assert model.geom("sphere_8").group[0] == 2


@pytest.mark.parametrize("task", ["mountain", "heightfield", "forest", "hill"])
def test_the_heightfield_is_the_terrain_to_the_millimetre(task):
    scene, model = one(task), compiled(task)
    rng = np.random.default_rng(0)
    low = np.array(scene.terrain.origin) + 0.1
    high = low - 0.2 + scene.terrain.cell * (np.array(scene.terrain.heights.shape) - 1)
    points = rng.uniform(low, high, (400, 2)).astype(np.float32)
    solid = np.full(model.ngeom, True)
    solid[model.geom("ground").id] = False
    model.geom_group[(model.geom_group == 2) & solid] = 5  # rays see the ground alone
    below = heights_below(model, points)
    model.geom_group[(model.geom_group == 5) & solid] = 2
    np.testing.assert_allclose(below, ground(scene.terrain, *points.T)[0], atol=1.1e-3)


@pytest.mark.parametrize("task", TASKS)
def test_the_robot_stands_at_home(task):
    scene, model = one(task), compiled(task)
    data = at_home(model)
    np.testing.assert_allclose(data.qpos, home_qpos(scene, A1), atol=1e-6)
    np.testing.assert_allclose(data.qpos[7:], A1.default_pose)
    feet = {f"{leg}_foot_sphere" for leg in LEGS}
    touching = {model.geom(geom).name for contact in data.contact for geom in contact.geom} & feet
    gap = [data.geom_xpos[model.geom(foot).id][2] - A1.leg_radii[0] for foot in feet]
    assert touching == feet or np.allclose(gap, 0.0, atol=1e-3)
    assert all(abs(contact.dist) < 2e-3 for contact in data.contact)
    assert model.body_mass.sum() == pytest.approx(12.453, abs=1e-6) and model.nu == 12


def test_start_and_heading():
    scene = one("stairs")
    top = float(scene.boxes.center[3, 0])
    model = scene_spec(scene, A1, start=(top, 0.5), yaw=0.7).compile()
    data = at_home(model)
    np.testing.assert_allclose(data.qpos[:3], [top, 0.5, 0.4 + A1.stand_height], atol=1e-6)
    forward = data.body("trunk").xmat.reshape(3, 3)[:, 0]
    np.testing.assert_allclose(forward, [np.cos(0.7), np.sin(0.7), 0], atol=1e-9)
    assert data.ncon >= 4 and min(contact.dist for contact in data.contact) > -1e-3


def test_obstacles_that_move_are_mocap_bodies():
    scene, model = one("moving"), compiled("moving")
    assert model.nmocap == 135 and compiled("thin").nmocap == 0
    data = at_home(model)
    for _ in range(25):
        scene = move(scene, 0.04)
    place_boxes(model, data, scene)
    mujoco.mj_forward(model, data)
    for i in np.flatnonzero(np.asarray(scene.boxes.kind) == OBSTACLE):
        for name in (f"obstacle_{i}", f"obstacle_{i}_contact"):
            np.testing.assert_allclose(data.geom(name).xpos, scene.boxes.center[i], atol=1e-6)


def test_the_robot_is_stopped_by_contact_geoms():
    """A trunk thrown at an obstacle stops at its contact face, 5 cm before the seen one."""
    scene = one("thin-sphere")
    box = int(np.argmin(np.asarray(scene.boxes.center)[:135, 0]))
    x, y, _ = np.asarray(scene.boxes.center[box])
    model = scene_spec(scene, A1, start=(x - 0.7, y)).compile()
    data = at_home(model)
    data.qpos[2], data.qvel[0] = 0.6, 1.0
    model.opt.gravity[:] = 0
    for _ in range(400):
        data.ctrl[:] = 40 * (np.array(A1.default_pose) - data.qpos[7:]) - 0.6 * data.qvel[6:]
        mujoco.mj_step(model, data)
        if data.ncon:
            break
    front = data.geom("trunk_front_sphere").xpos[0] + 0.057
    assert data.ncon and front == pytest.approx(x - 0.18 - 0.05, abs=0.01)


@pytest.mark.parametrize("task", TASKS)
def test_the_samples_open_by_themselves(task):
    path = SAMPLES / f"{task}.xml"
    assert path.stat().st_size < 600_000
    model = mujoco.MjModel.from_xml_string(path.read_text())
    assert model.ngeom == compiled(task).ngeom
    world = jax.tree.map(np.asarray, jax.jit(TASKS[task].generate)(jax.random.PRNGKey(0)))
    if world.boxes.count:
        name = f"{KIND_NAMES[int(world.boxes.kind[0])]}_0"
        np.testing.assert_allclose(at_home(model).geom(name).xpos, world.boxes.center[0], atol=1e-3)
    if world.terrain is not None:
        np.testing.assert_allclose(model.hfield_size[0][2], jp.ptp(world.terrain.heights), atol=2e-3)
