"""A robot in C MuJoCo that something goes wrong with when it has begun to run."""

from __future__ import annotations

import numpy as np

from loco_mjx.deploy.mujoco_robot import MujocoRobot
from tests.deploy import flat
from tests.known_robots import A1

RUNNING = 2.4  # s: standing up is over
FAULT = RUNNING + 0.4


class Faulty(MujocoRobot):
    """What it measures or does is changed from FAULT on; it also counts and keeps its commands."""

    def __init__(self, sensors=None, frame=None, before=None, **more):
        self.changes, self.commands = (sensors, frame, before), []
        super().__init__(flat.model(), flat.manifest().camera, **more)

    @property
    def broken(self):
        return self.now() > FAULT

    def read(self):
        value = super().read()
        return self.changes[0](value) if self.changes[0] and self.broken else value

    def depth(self):
        value = super().depth()
        return self.changes[1](value) if self.changes[1] and self.broken else value

    def command(self, targets, kp, kd):
        if self.changes[2] and self.broken:
            self.changes[2](self)
        self.commands.append((targets, kp, kd))
        super().command(targets, kp, kd)


class Clock(Faulty):
    """Its clock is changed from FAULT on."""

    def __init__(self, change, **more):
        self.change = change
        super().__init__(**more)

    def now(self):
        true = super().now()
        return self.change(true) if true > FAULT else true


def lies(robot):
    return robot.data.qpos[2] < 0.5 * A1.stand_height and np.abs(robot.data.qvel[6:]).max() < 1.0
