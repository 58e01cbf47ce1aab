"""The whole-body controller of one robot without JAX: what it remembers, its odometry, one tick after the other."""

from __future__ import annotations

import numpy as np

from loco_mjx import rotations
from loco_mjx.deploy.robot import Sensors
from loco_mjx.robots import Robot
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import controller, library, odometry
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.controller import Facts, Measured, State
from loco_mjx.whole_body.legs import body_of


class LowLevel:
    """Ticks of the controller; how fast the robot goes it is told by its legs.

    Attributes:
        config: of the controller.
        body: of the robot.
        state: of the controller.
        velocity: (3,) of the trunk in its own frame by odometry, m/s.
        stands: (4,) bool, the feet that odometry believes.
    """

    def __init__(self, about: Robot, solve: controller.Solver | None = None) -> None:
        """Takes the robot's figures, and the solver; quadprog if None.

        Raises:
            UserError: if quadprog is missing.
        """
        self.config, self.body = WholeBodyConfig(), body_of(about)
        self._solve = solve or library.make_solver(self.config.mpc)
        self.begin(np.array(about.default_pose))

    def begin(self, angles: np.ndarray) -> None:
        """A robot that stands, with joint angles (12,), is about to walk."""
        self.resume(controller.begin(self.config, self.body, angles), np.zeros(3), np.ones(4, bool))

    def resume(self, state: State, velocity: np.ndarray, stands: np.ndarray) -> None:
        """Goes on from a state, a velocity and feet that stand, as the attributes say."""
        self.state, self.velocity, self.stands = state, velocity, stands
        self._path, self._ticks = np.zeros(3), 0

    def tick(self, sensors: Sensors, wanted: np.ndarray) -> tuple[MotorCommand, Facts]:
        """What the motors are told for the next 5 ms under a command (2,), and what happened."""
        feet = np.asarray(sensors.feet, bool)
        self.velocity = odometry.velocity(
            self.body, sensors.angles, sensors.velocities, sensors.gyro, self.stands, self.velocity
        )
        self._path += rotations.matrix(sensors.quat) @ self.velocity
        self._ticks += 1
        measured = Measured(sensors.quat, sensors.gyro, self.velocity, sensors.angles, feet)
        command, self.state, facts = controller.tick(self.config, self.body, self._solve, self.state, wanted, measured)
        self.stands = facts.pushes & feet
        return command, facts

    def mean_velocity(self) -> np.ndarray:
        """(3,) of the trunk in the world's frame, m/s: the mean over the ticks since this was last asked."""
        mean = self._path / max(self._ticks, 1)
        self._path, self._ticks = np.zeros(3), 0
        return mean
