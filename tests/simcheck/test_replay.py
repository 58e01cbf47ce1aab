"""Seconds replayed: a faithful copy is found faithful, and each fault of a copy shows where it should."""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from loco_mjx.deploy.mujoco_robot import HIDDEN_GROUP, SEEN_GROUP
from loco_mjx.deploy.observer import Observer
from loco_mjx.scene import mjcf
from loco_mjx.scene.types import OBSTACLE
from loco_mjx.simcheck import replay as replay_lib
from loco_mjx.simcheck.replay import LENGTH, Recorder, replay
from loco_mjx.simcheck.run import replay_figures
from loco_mjx.simcheck.sides import WatchedRobot
from tests.deploy import flat
from tests.known_robots import A1
from tests.physics import world

STEPS = 130  # two windows, the first control steps of each at 0 and at 100
AHEAD = {"center": (1.2, 0.3, 0.3), "half": (0.1, 0.4, 0.3), "kind": OBSTACLE}  # to be seen
BEHIND = {"center": (-0.5, 0.0, 0.3), "half": (0.1, 0.6, 0.3), "kind": OBSTACLE}  # to be touched
MANIFEST = flat.manifest()
POSE = np.array(A1.default_pose)


def _policy(obs):
    """Pushes each joint on the way it goes, so that it does not come to rest, and looks at everything besides."""
    weights = np.random.default_rng(0).normal(size=(12, 93 + obs["depth"].size))
    seen = np.concatenate([obs["state"], obs["depth"].ravel()])
    way = obs["state"][-36:-24] - obs["state"][-24:-12]
    return POSE + 0.2 * np.tanh(12.0 * way) + 0.05 * np.tanh(0.3 * weights @ seen)


def _robot(boxes=(AHEAD, BEHIND), camera=MANIFEST.camera):
    return WatchedRobot(mjcf.scene_spec(world.scene(list(boxes)), A1).compile(), camera, lying=False)


def _state(robot, targets):
    physics = SimpleNamespace(qpos=robot.data.qpos[None].copy(), qvel=robot.data.qvel[None].copy())
    scene = SimpleNamespace(spheres=SimpleNamespace(collected=np.zeros((1, 0), bool)))
    contacts = np.array([float(robot.contact)])
    episode = SimpleNamespace(last_action=(targets - POSE)[None])
    return SimpleNamespace(
        pipeline_state=SimpleNamespace(physics=physics, scene=scene, episode=episode, control=None),
        metrics={"contacts": contacts},
    )


@pytest.fixture(scope="module")
def recorded():
    """Windows of a robot in C, to be replayed in C."""
    robot, observer, recorder, targets = _robot(), Observer(MANIFEST), Recorder(MANIFEST.hold, False, POSE), POSE
    for t in range(STEPS):
        before = _state(robot, targets)
        targets = _policy(observer.observe(robot.read(), robot.depth(), targets))
        robot.forget()
        for _ in range(A1.substeps):
            robot.command(targets, MANIFEST.kp, MANIFEST.kd)
        recorder(t, before, _state(robot, targets), np.array([True]))
    return recorder.windows


def _replayed(windows, robot=None, manifest=MANIFEST):
    ticks = []
    with ThreadPoolExecutor(1) as pool:
        again = replay(windows, [robot or _robot()], manifest, _policy, pool, lambda *tick: ticks.append(tick))
    assert ticks[-1] == (len(windows) * LENGTH, len(windows) * LENGTH)
    return again


def test_a_faithful_copy_is_found_faithful(recorded):
    again = _replayed(recorded)
    assert len(again.targets) == 2
    np.testing.assert_allclose(again.c["distance"], again.mjx["distance"], atol=1e-6)
    np.testing.assert_array_equal(again.c["contacts"], again.mjx["contacts"])
    assert again.targets.max() < 1e-6
    assert again.mjx["distance"].min() > 0.01 and again.mjx["contacts"].max() > 0  # there was something to compare


def test_faults_show_where_they_are(recorded):
    stiff = _replayed(recorded, manifest=dataclasses.replace(MANIFEST, kp=1.2 * MANIFEST.kp))
    assert np.abs(stiff.c["distance"] - stiff.mjx["distance"]).max() > 1e-3
    nothing = _replayed(recorded, robot=_robot(boxes=(AHEAD,)))
    assert nothing.c["contacts"].max() == 0
    shifted = dataclasses.replace(MANIFEST.camera, offset=(MANIFEST.camera.offset[0] + 0.02, 0.0, 0.0))
    blind = _replayed(recorded, robot=_robot(camera=shifted))
    np.testing.assert_allclose(blind.c["distance"], blind.mjx["distance"], atol=1e-6)  # physics has no camera
    assert blind.targets.max() > 1e-4
    swapped = dataclasses.replace(MANIFEST, fields=(*MANIFEST.fields[:2], *MANIFEST.fields[:1:-1]))
    assert _replayed(recorded, manifest=swapped).targets.min() > 1e-2


def test_only_whole_seconds_count_and_windows_begin_where_the_policy_looks(monkeypatch):
    monkeypatch.setattr(replay_lib, "LENGTH", 6)
    monkeypatch.setattr(replay_lib, "APART", 10)
    recorder, robot = Recorder(4, False, POSE), _robot()
    for t in range(30):
        recorder(t, _state(robot, POSE), _state(robot, POSE + 0.01 * t), np.array([t < 16]))
    assert [window.targets[-1][0, 0] for window in recorder.windows] == pytest.approx([0.05, 0.17, 0.29])
    assert [bool(window.whole[0]) for window in recorder.windows] == [True, False, False]
    with ThreadPoolExecutor(1) as pool:
        assert len(replay(recorder.windows, [robot], MANIFEST, _policy, pool, lambda *tick: None).targets) == 1


def test_a_policy_that_holds_its_depth_for_longer_than_a_second_is_not_compared(recorded):
    again = _replayed(recorded, manifest=dataclasses.replace(MANIFEST, hold=LENGTH + 1))
    assert np.isnan(again.targets).all() and np.isfinite(again.c["distance"]).all()
    assert replay_figures(again)["targets"] is None


def test_spheres_are_as_collected_as_in_the_state_it_is_put_into():
    robot = WatchedRobot(flat.model(), MANIFEST.camera, lying=False)
    qpos, qvel, sphere = robot.data.qpos.copy(), robot.data.qvel.copy(), robot.model.geom("sphere_0").id
    groups = []
    for collected in (True, False):
        robot.put(qpos, qvel, np.array([collected]))
        groups.append(robot.model.geom_group[sphere])
    assert groups == [HIDDEN_GROUP, SEEN_GROUP]
