"""Walks in C MuJoCo under the controller of NumPy, and everything that it saw and said on the way."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from loco_mjx.controllers import TICK
from loco_mjx.robots import LEGS, Robot
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import controller, library, odometry
from loco_mjx.whole_body.arrays import rotation
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import Body, body_of
from tests.known_robots import A1

pytest.importorskip("quadprog")  # the extra `mpc`

CONFIG = WholeBodyConfig()
BODY = body_of(A1)
SUBSTEPS = 2


class Seen(NamedTuple):
    """One tick: what the controller was given, and what it gave."""

    state: controller.State
    command: np.ndarray
    measured: controller.Measured
    told: MotorCommand
    after: controller.State
    facts: controller.Facts


class Walk(NamedTuple):
    """Ticks, and the robot's motion: (T, 7) poses and (T, 3) velocities ahead, aside and about the vertical."""

    ticks: list[Seen]
    poses: np.ndarray
    speeds: np.ndarray

    def fell(self) -> bool:
        up = 1 - 2 * (self.poses[:, 4] ** 2 + self.poses[:, 5] ** 2)
        return bool((up < 0.6).any() or (self.poses[:, 2] < 0.15).any())


def model(friction: float = 1.0, mass: float = 1.0, robot: Robot = A1) -> mujoco.MjModel:
    """A robot on a plane."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(type=plane, size=[0, 0, 1], contype=2, conaffinity=1)
    made = spec.compile()
    made.geom_friction[made.geom_priority == 1, 0] = friction
    made.body_mass *= mass
    made.body_inertia *= mass
    return made


def walk(
    world: mujoco.MjModel,
    command: Callable[[float], Sequence[float]],
    seconds: float,
    push: Callable[[float], float] = lambda time: 0.0,
    body: Body = BODY,
    by_legs: bool = False,
    solve: controller.Solver | None = None,
) -> Walk:
    """Walks from standing; `push` is a sideways force on the trunk at a time, N; `by_legs`: speed is not measured."""
    data = mujoco.MjData(world)
    mujoco.mj_resetDataKeyframe(world, data, 0)
    mujoco.mj_forward(world, data)
    solve = solve or library.make_solver(CONFIG.mpc)
    state = controller.begin(CONFIG, body, data.qpos[7:].copy())
    feet = [world.geom(f"{leg}_foot_sphere").id for leg in LEGS]
    ticks, poses, speeds, estimate, stands = [], [], [], np.zeros(3), np.ones(4, bool)
    for tick in range(round(seconds / TICK)):
        contacts = np.isin(feet, data.contact.geom[: data.ncon])
        angles, gyro = data.qpos[7:].copy(), data.qvel[3:6].copy()
        velocity = rotation(data.qpos[3:7]).T @ data.qvel[:3]
        if by_legs:
            velocity = estimate = odometry.velocity(body, angles, data.qvel[6:], gyro, stands, estimate)
        measured = controller.Measured(data.qpos[3:7].copy(), gyro, velocity, angles, contacts)
        wanted = np.array(command(tick * TICK), np.float64)
        told, after, facts = controller.tick(CONFIG, body, solve, state, wanted, measured)
        ticks.append(Seen(state, wanted, measured, told, after, facts))
        state, stands = after, facts.pushes & contacts
        data.xfrc_applied[1, 1] = push(tick * TICK)
        for _ in range(SUBSTEPS):
            torque = told.torque + told.kp * (told.angles - data.qpos[7:]) - told.kd * data.qvel[6:]
            data.ctrl[:] = np.clip(torque, -body.torque, body.torque)
            mujoco.mj_step(world, data)
        ahead = rotation(data.qpos[3:7])[:2, 0]
        vx, vy = data.qvel[:2]
        speeds.append([vx * ahead[0] + vy * ahead[1], vy * ahead[0] - vx * ahead[1], data.qvel[5]])
        poses.append(data.qpos[:7].copy())
    return Walk(ticks, np.stack(poses), np.stack(speeds))


@functools.cache
def recorded() -> list[Seen]:
    """1,000 ticks of walks: commands that jump, beyond the limits too, slippery and heavy, and a push."""
    random = np.random.default_rng(3)
    ticks = []
    for friction, mass, side in ((0.5, 0.8, 60.0), (1.25, 1.2, -60.0), (1.0, 1.0, 90.0), (0.7, 1.1, -90.0)):
        wanted = random.uniform([-0.6, -0.45], [0.6, 0.45], (5, 2))
        done = walk(
            model(friction, mass),
            lambda time, wanted=wanted: wanted[int(time / 0.25)],
            1.25,
            lambda time, side=side: side * (0.7 < time < 0.8),
        )
        ticks += done.ticks
    return ticks
