"""Unitree's A1 by its legged SDK's Python binding (`robot_interface`, unitree_legged_sdk 3.x), and its depth camera.

The SDK is on no package index: its build makes `robot_interface*.so`, to be put on PYTHONPATH. What of this file runs
without the robot is tested against a stand-in; docs/deployment.md lists what is not tested.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from loco_mjx.deploy.folder import Camera
from loco_mjx.deploy.lock import Lock
from loco_mjx.deploy.realsense import RealSense
from loco_mjx.deploy.robot import Frame, RobotError, Sensors
from loco_mjx.errors import UserError
from loco_mjx.robots import NJOINT

LOW_LEVEL = 0xFF
ADDRESS = (8080, "192.168.123.10", 8007)  # local port, the motor controller and its port
PRESSED = 20  # what a foot's sensor has to read for the foot to touch something; in the SDK's units
SERVO = 0x0A  # a motor's mode in which it follows targets
NO_POSITION, NO_VELOCITY = 2.146e9, 16000.0  # targets that mean there is none
CONNECT = 2.0  # s in which the robot has to answer
PERIOD = 0.0025  # s between commands
WAITING = 8  # packets at most that have come since the last look
LAST = 3  # packets that let the motors go
SILENT, ASKED = 2 * PERIOD, 3  # s without a packet, after which so many more are asked for


class A1Robot:
    """The robot protocol on the A1. Where it is in the world it does not know: `Sensors.position` is None."""

    name = "a1"

    def __init__(self, camera: Camera | None) -> None:
        """Connects; no motor gets a target or a gain.

        The robot only answers who speaks to it, so it is sent packets that ask for nothing: its motors stay limp.

        Args:
            camera: of the policy; None opens no camera.

        Raises:
            UserError: if the SDK or pyrealsense2 is missing, another runner has the robot, or robot or camera do not
                answer.
        """
        try:
            self._sdk: Any = importlib.import_module("robot_interface")
        except ImportError as error:
            raise UserError(
                f"--robot a1 needs Unitree's robot_interface ({error}); build unitree_legged_sdk with its Python "
                "binding and put it on PYTHONPATH"
            ) from error
        self._lock = Lock(f"a1-{ADDRESS[1]}")
        self._udp = self._sdk.UDP(LOW_LEVEL, *ADDRESS)
        self._safety = self._sdk.Safety(self._sdk.LeggedType.A1)
        self._command, self._state = self._sdk.LowCmd(), self._sdk.LowState()
        self._udp.InitCmdData(self._command)
        self._tick: int | None = None
        self._heard = self._due = self._sent = self.now()
        self._camera: RealSense | None = None
        self._closed = False
        try:
            self._connect()
            if camera is not None:
                self._camera = RealSense(camera, self.now)
                self._camera.wait()
        except RobotError as error:
            self.close()
            raise UserError(f"the robot is not ready ({error}); it was not commanded") from error
        except BaseException:
            self.close()
            raise

    def now(self) -> float:
        """The computer's monotonic clock, s."""
        return time.monotonic()

    def read(self) -> Sensors:
        """The newest measurements; their time is that of the packet that brought them.

        Where none has come for a while, since nothing was sent, the last packet is sent again: before the first command
        it asks for nothing, then for what the motors do anyway.

        Raises:
            RobotError: if there has never been any.
        """
        self._receive()
        self._ask()
        if self._tick is None:
            raise RobotError(
                "the robot does not answer; is it on, in low-level mode, and this computer in its network?"
            )
        motors, imu = self._state.motorState, self._state.imu
        forces = getattr(self._state, "footForce", None)
        return Sensors(
            time=self._heard,
            angles=np.array([motors[i].q for i in range(NJOINT)], np.float64),
            velocities=np.array([motors[i].dq for i in range(NJOINT)], np.float64),
            quat=np.array(imu.quaternion, np.float64),
            gyro=np.array(imu.gyroscope, np.float64),
            feet=None if forces is None else np.array(forces, np.float64) > PRESSED,
        )

    def depth(self) -> Frame:
        """The newest image.

        Raises:
            RobotError: if there is no camera, or it has failed.
        """
        if self._camera is None:
            raise RobotError("there is no camera")
        return self._camera.depth()

    def command(self, targets: np.ndarray, kp: float, kd: float) -> None:
        """Sends PD targets, and returns when the next ones are due, 2.5 ms after these."""
        none = np.zeros(NJOINT)
        self.drive(targets, none, np.full(NJOINT, kp), np.full(NJOINT, kd), none)

    def drive(
        self, angles: np.ndarray, velocities: np.ndarray, kp: np.ndarray, kd: np.ndarray, torque: np.ndarray
    ) -> None:
        """Sends targets, gains and torques, and returns when the next ones are due, 2.5 ms after these."""
        told = zip(self._command.motorCmd, angles, velocities, kp, kd, torque, strict=False)  # it has 20 motors' room
        for motor, *values in told:
            motor.mode = SERVO
            motor.q, motor.dq, motor.Kp, motor.Kd, motor.tau = (float(value) for value in values)
        self._safety.PositionLimit(self._command)
        time.sleep(max(self._sent + PERIOD - self.now(), 0.0))  # what is late is made up for, but never two at once
        self._send()
        now = self.now()
        self._due = max(self._due + PERIOD, now)
        time.sleep(self._due - now)

    def close(self) -> None:
        """Lets the motors go limp and stops the camera. Again, it does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            for _ in range(LAST):  # a packet may be lost
                self._idle()
                time.sleep(PERIOD)
        finally:
            if self._camera is not None:
                self._camera.close()
            self._lock.release()

    def _connect(self) -> None:
        end = self.now() + CONNECT
        while self._tick is None and self.now() < end:
            self._idle()
            time.sleep(PERIOD)
            self._receive()
        self.read()

    def _ask(self) -> None:
        for _ in range(ASKED):
            if self._tick is None or self.now() - self._heard <= SILENT:
                return
            self._send()
            time.sleep(PERIOD)
            self._receive()

    def _idle(self) -> None:
        for motor in self._command.motorCmd[:NJOINT]:
            motor.mode, motor.q, motor.dq = SERVO, NO_POSITION, NO_VELOCITY
            motor.Kp = motor.Kd = motor.tau = 0.0
        self._send()

    def _send(self) -> None:
        self._udp.SetSend(self._command)
        self._udp.Send()
        self._sent = self.now()

    def _receive(self) -> None:
        """Takes in all that has come. A packet is new if the robot's own clock has gone on."""
        for _ in range(WAITING):
            self._udp.Recv()
            self._udp.GetRecv(self._state)
            tick = int(self._state.tick)
            if tick == (self._tick or 0):
                return
            self._tick, self._heard = tick, self.now()
