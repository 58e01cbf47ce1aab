"""Seconds of MJX's episodes again in C MuJoCo: from the same states, with the same commands.

Whole episodes part, contacts being chaotic, and agree in their means at best. A second is too short for that: whatever
differs in it is a fault of physics. And C's camera and observation, made of the same motion, have to lead the policy to
the same targets: whatever differs there is a fault of depth or observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from loco_mjx.deploy.folder import Manifest
from loco_mjx.env.state import State
from loco_mjx.robots import Robot, get_robot
from loco_mjx.scene import mjcf
from loco_mjx.simcheck.follow import make_follower
from loco_mjx.simcheck.sides import Policy, WatchedRobot, one

LENGTH = 25  # control steps of a window: 1 s
APART = 100  # control steps between the starts of two, at least


@dataclass
class Window:
    """A second of all episodes, E of them.

    Attributes:
        first: state before it.
        targets: per control step (E, 12), rad, or commands (E, 2); those before the window first.
        contacts: per control step (E,), whether anything was touched.
        scenes: per control step, if it moves.
        end: (E, 3) position after it, m.
        whole: (E,) bool, whether the episode lasted to its end.
    """

    first: State
    targets: list[np.ndarray]
    contacts: list[np.ndarray] = field(default_factory=list)
    scenes: list[Any] = field(default_factory=list)
    end: np.ndarray | None = None
    whole: np.ndarray | None = None


class Recorder:
    """Keeps windows of a run of :class:`loco_mjx.simcheck.sides.MjxSide`."""

    def __init__(self, hold: int, moving: bool, neutral: np.ndarray) -> None:
        """Keeps nothing yet.

        Args:
            hold: the policy's, whose looks at depth every window begins with.
            moving: whether obstacles move.
            neutral: what the policy's targets are relative to (loco_mjx/env/action.py).
        """
        self._neutral = neutral
        self._every, self._moving = hold * -(-APART // hold), moving
        self._open: Window | None = None
        self.windows: list[Window] = []

    def __call__(self, t: int, before: State, after: State, alive: np.ndarray) -> None:
        """Takes in control step t, after which `alive` (E,) episodes go on."""
        at = t % self._every
        if at == 0:
            self._open = Window(jax.device_get(before), [_targets(before, self._neutral)])
        if self._open is None or at >= LENGTH:
            return
        self._open.targets.append(_targets(after, self._neutral))
        self._open.contacts.append(np.asarray(after.metrics["contacts"]))
        if self._moving:
            self._open.scenes.append(jax.device_get(after.pipeline_state.scene))
        if at == LENGTH - 1:
            self._open.end = np.asarray(after.pipeline_state.physics.qpos[:, :3], np.float64)
            self._open.whole = alive.copy()
            self.windows.append(self._open)


@dataclass(frozen=True)
class Replayed:
    """What the windows say, W of them.

    Attributes:
        seconds: length of each.
        c: `distance` from start to end, m, and `contacts`, control steps; (W,) each.
        mjx: the same.
        targets: (W,) mean absolute difference between the policy's targets on C's observation and on MJX's, rad, or
            the unit of its commands; NaN for a policy that still sees at a window's end what was before it.
    """

    seconds: float
    c: dict[str, np.ndarray]
    mjx: dict[str, np.ndarray]
    targets: np.ndarray


def replay(
    windows: Sequence[Window],
    robots: Sequence[WatchedRobot],
    manifest: Manifest,
    policy: Policy,
    pool: Executor,
    tick: Callable[[int, int], None],
) -> Replayed:
    """Runs the windows in C.

    Args:
        windows: of a :class:`Recorder`.
        robots: C's, one per episode, in its scene.
        manifest: of the policy.
        policy: from observations to targets.
        pool: runs the episodes.
        tick: told how many control steps of them are done, of how many.
    """
    about = get_robot(manifest.body)
    rows: list[tuple[float, float, float, float, float]] = []
    for done, window in enumerate(windows, 1):
        assert window.whole is not None
        again = lambda i, window=window: _again(window, int(i), robots[i], manifest, about, policy)  # noqa: E731
        rows += pool.map(again, np.flatnonzero(window.whole))
        tick(done * LENGTH, len(windows) * LENGTH)
    columns = np.array(rows).reshape(-1, 5).T
    c, mjx = ({"distance": columns[i], "contacts": columns[i + 1]} for i in (0, 2))
    return Replayed(LENGTH / manifest.policy_hz, c, mjx, columns[4])


def _again(
    window: Window, i: int, robot: WatchedRobot, manifest: Manifest, about: Robot, policy: Policy
) -> tuple[float, float, float, float, float]:
    """One episode's window: distance and contacts in C and in MJX, and how far the targets differ."""
    physics, scene = window.first.pipeline_state.physics, window.first.pipeline_state.scene
    robot.put(physics.qpos[i], physics.qvel[i], scene.spheres.collected[i])
    follower, touched, away = make_follower(manifest, about), 0, []
    follower.resume(one(window.first.pipeline_state.control, i), robot)
    settled = _settled(manifest)
    for k in range(LENGTH):
        decided = policy(follower.observe(robot, window.targets[k][i]))
        given = window.targets[k + 1][i]
        if k >= settled:
            away.append(np.abs(decided - given).mean())
        if window.scenes:
            mjcf.place_boxes(robot.model, robot.data, one(window.scenes[k], i))
        robot.forget()
        follower.follow(robot, given)
        touched += robot.contact
    start, end = np.asarray(physics.qpos[i, :3], np.float64), np.asarray(window.end)[i]
    moved = [float(np.linalg.norm(there - start)) for there in (robot.data.qpos[:3], end)]
    return moved[0], touched, moved[1], float(np.sum([contact[i] for contact in window.contacts])), _mean(away)


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def _settled(manifest: Manifest) -> int:
    """Control steps after which nothing is left in the histories, and in the held depth, of before the window."""
    frames = [part.frames for part in manifest.fields] + ([manifest.camera.frames] if manifest.camera else [])
    return manifest.hold * -(-max(frames) // manifest.hold)


def _targets(state: State, neutral: np.ndarray) -> np.ndarray:
    return np.asarray(state.pipeline_state.episode.last_action, np.float64) + neutral
