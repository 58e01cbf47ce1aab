"""The whole-body controller on a robot: stand up, walk as commanded at 200 ticks a second, sit down. Needs no JAX."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from loco_mjx.controllers import TICK, get_controller
from loco_mjx.deploy.estop import EmergencyStop
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.low_level import LowLevel
from loco_mjx.deploy.observer import up
from loco_mjx.deploy.robot import DrivenRobot, Frame, Sensors
from loco_mjx.deploy.runner import STILL, Runner
from loco_mjx.deploy.safety import Cause, Limits, Stop
from loco_mjx.deploy.worker import Overdue
from loco_mjx.errors import UserError
from loco_mjx.robots import Robot, joint_names
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import controller
from loco_mjx.whole_body.controller import Facts

STAND_STILL = 0.4  # s, to get from the gait to the standing pose, and to stay there
Wanted = Callable[[float], tuple[float, float]]  # speed ahead, m/s, and yaw rate, rad/s, at a time, s


def manifest_of(robot: Robot) -> Manifest:
    """What the runner and its guard have to know of a robot that no policy runs."""
    return Manifest(
        policy="mpc",
        robot=robot.name,
        body=str(robot.path),
        fields=(),
        camera=None,
        joints=joint_names(),
        default_pose=np.array(robot.default_pose),
        lower=np.array(robot.lower),
        upper=np.array(robot.upper),
        torque_limit=np.array(robot.torque_limit),
        kp=robot.kp,
        kd=robot.kd,
        policy_hz=round(1 / TICK),
        pd_hz=round(1 / robot.physics_dt),
        hold=1,
        controller=get_controller("mpc"),
        raw={},
    )


class Walker(Runner):
    """Walks one robot. How fast it goes it is told by its legs; what it is commanded, by a function of time.

    Attributes:
        unsolved: quadratic programs that were not solved, of all.
        clipped: ticks whose command was beyond the limits.
    """

    for_controller = "mpc"
    robot: DrivenRobot

    def __init__(
        self,
        about: Robot,
        wanted: Wanted,
        robot: DrivenRobot,
        limits: Limits | None = None,
        estop: EmergencyStop | None = None,
        clock: Callable[[], float] = time.perf_counter,
        say: Callable[[float, str], None] = lambda when, text: None,
        patience: float = 0.0,
        solve: controller.Solver | None = None,
        manifest: Manifest | None = None,
    ) -> None:
        """Prepares a run; the robot is not touched.

        Args:
            about: the robot's figures.
            wanted: the command at a time since the walk began.
            robot: to run it on.
            limits: when to stop.
            estop: whoever may press it.
            clock: for the ticks' latency, s.
            say: told about every event as it happens, with the robot's time, s.
            patience: s that a tick may at least take on the wall's clock before the robot is sat down without it.
            solve: the solver; quadprog if None.
            manifest: of the policy that commands it, if one does.

        Raises:
            UserError: if quadprog is missing.
        """
        about_it = manifest or manifest_of(about)
        super().__init__(about_it, lambda obs: np.zeros(0), robot, limits, estop, clock, say, patience)
        self._patience = max((1 + self.guard.limits.missed) * TICK, patience)
        self._wanted, self._low = wanted, LowLevel(about, solve)
        self.unsolved = self.clipped = 0
        self._spent = 0.0  # s that a tick took before it began to measure

    def _check_policy(self, sensors: Sensors, frame: Frame | None) -> None:
        """One tick that is thrown away."""
        if sensors.feet is None:
            raise UserError("the robot does not feel its feet, and the whole-body controller has to know which touch")
        self._low.tick(sensors, np.zeros(2))

    def _run_policy(self, seconds: float) -> None:
        self._low.begin(self._measure().angles)
        due = begin = self.robot.now()
        walking, stopping = round(seconds / TICK), round(self._low.config.gait.cycle / TICK)
        for tick in range(walking + 2 * stopping):
            wanted = self._want(tick, self.robot.now() - begin) if tick < walking else np.zeros(2)
            command = self._walk(wanted)
            due = max(due + TICK, self.robot.now())
            self._drive(command, due)
            if tick >= walking + stopping and not np.any(command.kp):  # all four stand
                break
        self._move(self.manifest.default_pose, STAND_STILL, STAND_STILL)

    def _want(self, tick: int, seconds: float) -> np.ndarray:
        """The command (2,) of a tick, so many seconds after the first."""
        return np.array(self._wanted(seconds), np.float64)

    def _walk(self, wanted: np.ndarray) -> MotorCommand:
        """Measures and decides."""
        begin = self._clock()
        sensors = self._measure()
        sensed = self._spent + self._clock() - begin
        try:
            command, facts, took = self._worker.call(
                lambda: self._decided(sensors, wanted), self._patience, self.estop.poll
            )
        except Overdue:
            raise Stop(Cause.DEADLINE, f"a tick has not ended after {1000 * self._patience:.0f} ms") from None
        if facts.clipped and not self.clipped:
            limited = controller.clip(wanted)
            self._event(f"command {wanted[0]:g} m/s, {wanted[1]:g} rad/s clipped to {limited[0]:g}, {limited[1]:g}")
        self.clipped += int(facts.clipped)
        self.unsolved += int(facts.unsolved)
        self._remember(sensors, wanted, command, facts, sensed + took)
        self.guard.deadline(sensed + took, TICK)
        if self._low.state.failed >= self.guard.limits.unsolved:
            raise Stop(Cause.SOLVER, f"{int(self._low.state.failed)} in a row")
        return command

    def _decided(self, sensors: Sensors, wanted: np.ndarray) -> tuple[MotorCommand, Facts, float]:
        """Command, facts, and the time they took, s; runs in the worker's thread."""
        begin = self._clock()
        command, facts = self._low.tick(sensors, wanted)
        return command, facts, self._clock() - begin

    def _remember(
        self, sensors: Sensors, wanted: np.ndarray, command: MotorCommand, facts: Facts, latency: float
    ) -> None:
        row = {"time": sensors.time, "latency": latency, "wanted": wanted, "up": up(sensors.quat)}
        row |= {"angles": sensors.angles, "velocities": sensors.velocities, "quat": sensors.quat, "gyro": sensors.gyro}
        row |= {"targets": command.angles, "torque": command.torque, "pushes": facts.pushes, "feet": sensors.feet}
        row |= {"unsolved": facts.unsolved, "velocity": self._low.velocity}
        if sensors.position is not None:
            row["position"] = sensors.position
        self.record.rows.append(row)
        if "position" in row:
            self.record.distance = float(np.linalg.norm(row["position"] - self.record.rows[0]["position"]))

    def _drive(self, command: MotorCommand, until: float) -> None:
        """The same command, clamped anew each time, until the next tick."""
        for _ in range(round(STILL * self.manifest.pd_hz * TICK)):
            sensors = self._measure()
            safe = self.guard.motors(command, sensors)
            self._commanded = np.where(safe.kp > 0, safe.angles, sensors.angles)
            self.robot.drive(*safe)
            if self.robot.now() > until - 0.5 / self.manifest.pd_hz:
                return
        raise Stop(Cause.CLOCK, "the robot's clock stands still, or goes much too slowly")
