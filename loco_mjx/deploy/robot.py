"""What a robot has to be able to do to be run by a policy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class RobotError(RuntimeError):
    """The robot does not answer, or answers what cannot be."""


@dataclass(frozen=True)
class Sensors:
    """What the body measures. Vectors of 12 are in the order FR, FL, RR, RL, each (hip, thigh, calf).

    Attributes:
        time: of the measurement, s, on the robot's clock.
        angles: (12,) rad.
        velocities: (12,) rad/s.
        quat: (4,) orientation of the trunk (w, x, y, z).
        gyro: (3,) angular velocity in the trunk's frame, rad/s.
        position: (3,) of the trunk in the world, m; None if the robot does not know it.
        feet: (4,) bool, which feet touch something; None if the robot does not feel it.
    """

    time: float
    angles: np.ndarray
    velocities: np.ndarray
    quat: np.ndarray
    gyro: np.ndarray
    position: np.ndarray | None = None
    feet: np.ndarray | None = None


@dataclass(frozen=True)
class Frame:
    """A depth image.

    Attributes:
        time: of the exposure, s, on the robot's clock.
        depth: (height, width) planar depth, m, of the size and field of view the policy was trained with; row 0 on
            top, column 0 on the left; the far clip where nothing was measured.
    """

    time: float
    depth: np.ndarray


class Robot(Protocol):
    """A robot. `read` and `depth` return at once with the newest there is; `command` paces the loop.

    Attributes:
        name: whose policies it runs, e.g. "a1".
    """

    name: str

    def now(self) -> float:
        """The robot's clock, s."""
        ...

    def read(self) -> Sensors:
        """The newest measurements.

        Raises:
            RobotError: if the robot does not answer.
        """
        ...

    def depth(self) -> Frame:
        """The newest depth image.

        Raises:
            RobotError: if the camera does not answer.
        """
        ...

    def command(self, targets: np.ndarray, kp: float, kd: float) -> None:
        """Sends PD targets (12,) rad, and returns when the next command is due, 1 / pd_hz later.

        Raises:
            RobotError: if the robot does not answer.
        """
        ...

    def close(self) -> None:
        """Lets go of the robot: its motors get neither targets nor gains any more."""
        ...


class DrivenRobot(Robot, Protocol):
    """A robot whose motors take more than targets: what the whole-body controller needs."""

    def drive(
        self, angles: np.ndarray, velocities: np.ndarray, kp: np.ndarray, kd: np.ndarray, torque: np.ndarray
    ) -> None:
        """Sends each motor torque + kp (angle − q) + kd (velocity − q̇), each (12,), SI, and returns as `command` does.

        Raises:
            RobotError: if the robot does not answer.
        """
        ...
