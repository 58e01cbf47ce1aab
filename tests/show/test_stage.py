"""The camera behind the robot sees the robot, and the goal that lies ahead."""

from __future__ import annotations

import math

import jax
import mujoco
import numpy as np
import pytest

from loco_mjx.scene.mjcf import home_qpos
from loco_mjx.scene.tasks import get_task
from loco_mjx.show.rollout import Moment
from loco_mjx.show.stage import BELOW, FIELD, Follower, goal_top
from tests.known_robots import A1


def moment(scene, start=(0.0, 0.0), yaw=0.0):
    return Moment(home_qpos(scene, A1, start, yaw), scene, None, None, 0, 0, 0.0, False)


def seen(camera, point, ratio):
    """Right and up in the view, each from −1 to 1 inside it; by the axes of the camera as MuJoCo defines them."""
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    ahead = math.cos(elevation) * level + np.array([0, 0, math.sin(elevation)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    away = point - (np.array(camera.lookat) - camera.distance * ahead)
    slope = math.tan(math.radians(FIELD / 2)) * (away @ ahead)
    return away @ right / (slope * ratio), away @ np.cross(right, ahead) / slope


@pytest.mark.parametrize("task", ["mountain", "hill"])
def test_the_goal_is_in_view_on_the_way_to_it_and_so_is_the_robot(task):
    generate = jax.jit(get_task(task).generate)
    for seed in range(6):
        scene = generate(jax.random.PRNGKey(seed))
        goal = np.asarray(scene.goal, float)
        for part in (0.0, 0.3, 0.6, 0.8):
            there = moment(scene, tuple(part * goal[:2]), math.atan2(goal[1], goal[0]))
            camera, top = Follower().follow(there), goal_top(scene)
            trunk = there.qpos[:3]
            assert top[2] > goal[2]
            for point in (top, trunk + np.array([0, 0, 0.2]), trunk - np.array([0, 0, BELOW])):
                assert np.abs(seen(camera, point, 16 / 9)).max() < 1.0, (seed, part, point)


def test_a_goal_behind_moves_nothing_and_neither_does_none():
    scene = jax.jit(get_task("hill").generate)(jax.random.PRNGKey(0))
    away = Follower().follow(moment(scene, yaw=math.pi))
    plain = Follower(elevation=-24.0)
    assert away.elevation == pytest.approx(-24.0)
    flat = jax.jit(get_task("thin-sphere").generate)(jax.random.PRNGKey(0))  # its spheres are no goal
    assert goal_top(flat) is None
    camera = plain.follow(moment(flat))
    assert (camera.elevation, camera.distance) == (pytest.approx(-24.0), 2.6)


def test_the_field_is_mujocos():
    assert mujoco.MjModel.from_xml_string("<mujoco/>").vis.global_.fovy == FIELD
