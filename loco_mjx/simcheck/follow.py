"""Whoever carries out what an exported policy decides, on C MuJoCo's robot: for one control step, without any guard."""

from __future__ import annotations

from typing import Any, Protocol

import jax
import numpy as np

from loco_mjx.controllers import TICK, ticks
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.low_level import LowLevel
from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.observer import Observer
from loco_mjx.robots import Robot
from loco_mjx.whole_body.arrays import rotation


class Follower(Protocol):
    """One episode's controller and observer."""

    def resume(self, control: Any, robot: MujocoRobot) -> None:
        """Goes on in the middle of an episode of ours, from what its controller remembers (`World.control`)."""
        ...

    def observe(self, robot: MujocoRobot, before: np.ndarray) -> dict[str, np.ndarray]:
        """The policy's next observation, after the targets of the control step before."""
        ...

    def follow(self, robot: MujocoRobot, decided: np.ndarray) -> None:
        """A control step under what the policy decided."""
        ...

    def facts(self) -> dict[str, float]:
        """What the controller reports of the last control step, by the names of its metrics."""
        ...


class Held:
    """Controller `pd`."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest, self._observer = manifest, Observer(manifest)

    def resume(self, control: Any, robot: MujocoRobot) -> None:
        """It remembers nothing."""

    def observe(self, robot: MujocoRobot, before: np.ndarray) -> dict[str, np.ndarray]:
        """With the last targets."""
        return self._observer.observe(robot.read(), _frame(robot), before)

    def follow(self, robot: MujocoRobot, decided: np.ndarray) -> None:
        """The same targets for every physics step."""
        for _ in range(self._manifest.pd_hz // self._manifest.policy_hz):
            robot.command(decided, self._manifest.kp, self._manifest.kd)

    def facts(self) -> dict[str, float]:
        """None."""
        return {}


class Walked:
    """Controller `mpc`, as on a robot: in NumPy, with quadprog, by odometry."""

    def __init__(self, manifest: Manifest, about: Robot) -> None:
        self._observer, self._low, self._unsolved = Observer(manifest), LowLevel(about), 0
        self._ticks = ticks(manifest.policy_hz)
        self._substeps = round(manifest.pd_hz * TICK)

    def resume(self, control: Any, robot: MujocoRobot) -> None:
        """With the velocity that the robot has."""
        kind = lambda x: np.float64 if x.dtype == np.float32 else x.dtype  # noqa: E731
        state = jax.tree.map(lambda x: np.asarray(x, kind(x))[()], control.memory.state)
        velocity = rotation(robot.data.qpos[3:7]).T @ robot.data.qvel[:3]
        self._low.resume(state, velocity, np.asarray(control.contacts))

    def observe(self, robot: MujocoRobot, before: np.ndarray) -> dict[str, np.ndarray]:
        """With the mean velocity of the last control step."""
        return self._observer.observe(robot.read(), _frame(robot), None, self._low.mean_velocity())

    def follow(self, robot: MujocoRobot, decided: np.ndarray) -> None:
        """The controller's ticks."""
        self._unsolved = 0
        for _ in range(self._ticks):
            told, facts = self._low.tick(robot.read(), np.asarray(decided, np.float64))
            self._unsolved += int(facts.unsolved)
            for _ in range(self._substeps):
                robot.drive(*told)

    def facts(self) -> dict[str, float]:
        """Programs that were not solved."""
        return {"unsolved": float(self._unsolved)}


def make_follower(manifest: Manifest, about: Robot) -> Follower:
    """Whoever carries out a policy's decisions on a robot.

    Raises:
        UserError: if quadprog is missing and the policy's controller needs it.
    """
    return Walked(manifest, about) if manifest.controller.name == "mpc" else Held(manifest)


def _frame(robot: MujocoRobot) -> Any:
    return robot.depth() if robot.camera is not None else None
