"""The control loop: checks, stand up, run the policy at its rate over PD commands at theirs, sit down."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping

import numpy as np

from loco_mjx import controllers
from loco_mjx.deploy.estop import EmergencyStop
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.observer import Observer, check_readable, up
from loco_mjx.deploy.record import Record
from loco_mjx.deploy.robot import Frame, Robot, RobotError, Sensors
from loco_mjx.deploy.safety import Cause, Guard, Limits, Stop
from loco_mjx.deploy.worker import Overdue, Worker
from loco_mjx.errors import UserError
from loco_mjx.robots import LEGS, NJOINT

Policy = Callable[[Mapping[str, np.ndarray]], np.ndarray]
SIT = np.tile([0.0, 1.35, -2.6], len(LEGS))  # rad, lying on the belly with folded legs
MOVE_GAINS = (80.0, 1.0)  # N·m/rad, N·m·s/rad, for standing up and sitting down
STAND, HOLD, SIT_DOWN = 2.0, 0.4, 2.0  # s
DAMPED_GAINS = (15.0, 2.5)  # the first fades to 0 while the robot sinks
DAMPED, LIMP = 1.6, 0.4  # s
STILL = 10  # times as many commands as a tick has, after which the robot's clock has to have gone on
FLUSH = 1.0  # s to wait for the last event to be told


class Runner:
    """Runs one policy on one robot.

    Attributes:
        for_controller: whose policies it runs.
    """

    for_controller = controllers.DEFAULT

    def __init__(
        self,
        manifest: Manifest,
        policy: Policy,
        robot: Robot,
        limits: Limits | None = None,
        estop: EmergencyStop | None = None,
        clock: Callable[[], float] = time.perf_counter,
        say: Callable[[float, str], None] = lambda when, text: None,
        patience: float = 0.0,
    ) -> None:
        """Prepares a run; the robot is not touched.

        Args:
            manifest: of the policy's folder, checked.
            policy: from an observation to (12,) joint targets, rad.
            robot: to run it on.
            limits: when to stop.
            estop: whoever may press it.
            clock: for the ticks' latency, s.
            say: told about every event as it happens, with the robot's time, s.
            patience: s that a tick may at least take on the wall's clock before the robot is sat down without it.

        Raises:
            UserError: if the policy is another controller's.
        """
        if manifest.controller.name != self.for_controller:
            raise UserError(
                f"policy '{manifest.policy}' gives {manifest.controller.output} to controller "
                f"'{manifest.controller.name}'; this runs those of '{self.for_controller}'"
            )
        self.manifest, self.policy, self.robot = manifest, policy, robot
        self.guard = Guard(manifest, limits or Limits())
        self.estop = estop or EmergencyStop()
        self.record = Record()
        self._clock, self._say = clock, say
        self._observer = Observer(manifest)
        self._commanded: np.ndarray | None = None
        period = 1 / manifest.policy_hz
        self._patience = max((1 + self.guard.limits.missed) * period, patience)
        self._worker, self._voice = Worker("policy"), Worker("events")

    def check(self) -> None:
        """Everything that can be known before the first command.

        Raises:
            UserError: if the robot is not the policy's, does not answer, lacks what the policy reads, or stands in a
                way it should not.
        """
        if self.robot.name != self.manifest.robot:
            raise UserError(
                f"the policy is {self.manifest.robot}'s, the robot is {self.robot.name}; it was not commanded"
            )
        try:
            sensors = self.robot.read()
            self.guard.sensors(sensors, self.robot.now())
            frame = self._look()
        except (RobotError, Stop) as error:
            raise UserError(f"the robot is not ready ({error}); it was not commanded") from error
        check_readable(self.manifest, sensors.position is not None)
        self._check_policy(sensors, frame)

    def _check_policy(self, sensors: Sensors, frame: Frame | None) -> None:
        """One tick that is thrown away; it also warms up the runtime."""
        targets = self.policy(Observer(self.manifest).observe(sensors, frame, self.manifest.default_pose))
        if targets.shape != (NJOINT,) or not np.all(np.isfinite(targets)):
            raise UserError(f"the policy's output is not {NJOINT} numbers; export the run again")

    def run(self, seconds: float) -> Record:
        """Stands up, runs the policy, sits down.

        Args:
            seconds: to run the policy for.

        Raises:
            UserError: from :meth:`check`, before any command.
        """
        self.check()
        with self.estop.listening():
            try:
                self._event("standing up")
                self._move(self.manifest.default_pose, STAND, HOLD)
                self._event("running")
                self._run_policy(seconds)
                self._event("sitting down")
                self._move(SIT, SIT_DOWN, 0.0)
            except Stop as stop:
                self._fault(stop.cause, stop.detail)
            except (RobotError, OSError) as error:
                self._fault(Cause.ROBOT, str(error))
            except Exception as error:  # a bug: the robot does not pay for it, and the record is kept
                self._fault(Cause.FAILURE, f"{type(error).__name__}: {error}")
            except BaseException:
                self._sink()
                raise
            self.record.misses, self.record.clamped = self.guard.misses, self.guard.clamped
            self._event("done")
            self._flush()
        return self.record

    def _fault(self, cause: Cause, detail: str) -> None:
        """Keeps why the run ends, and sits down."""
        self.record.cause, self.record.detail = str(cause), detail
        self._event(f"{cause}: {detail}")
        self._sink()

    def _run_policy(self, seconds: float) -> None:
        period = 1 / self.manifest.policy_hz
        targets, due, start = self.manifest.default_pose, self.robot.now(), None
        for _ in range(round(seconds * self.manifest.policy_hz)):
            sensors, targets = self._tick(targets, period)
            start = sensors.position if start is None else start
            due = max(due + period, self.robot.now())
            self._hold(targets, due)
        end = self.robot.read().position
        if start is not None and end is not None:
            self.record.distance = float(np.linalg.norm(end - start))

    def _tick(self, before: np.ndarray, period: float) -> tuple[Sensors, np.ndarray]:
        """Measures and decides: the policy's targets as they came, not clamped, for they are its next input."""
        begin = self._clock()
        sensors = self._measure()
        sensed = self._clock() - begin
        try:
            frame, obs, targets, took = self._worker.call(
                lambda: self._decide(sensors, before), self._patience, self.estop.poll
            )
        except Overdue:
            raise Stop(Cause.DEADLINE, f"a tick has not ended after {1000 * self._patience:.0f} ms") from None
        latency = sensed + took
        self._keep(sensors, frame, obs, targets, latency)
        self.guard.action(targets)
        self.guard.deadline(latency, period)
        return sensors, targets

    def _decide(
        self, sensors: Sensors, before: np.ndarray
    ) -> tuple[Frame | None, dict[str, np.ndarray], np.ndarray, float]:
        """Image, observation, targets and the time they took, s; runs in the worker's thread, which may hang."""
        begin, frame = self._clock(), self._look()
        obs = self._observe(sensors, frame, before)
        targets = self._asked(obs)
        return frame, obs, targets, self._clock() - begin

    def _look(self) -> Frame | None:
        """The newest image, checked; None if the policy reads none."""
        if self.manifest.camera is None:
            return None
        frame = self.robot.depth()
        self.guard.frame(frame, self.robot.now())
        return frame

    def _asked(self, obs: dict[str, np.ndarray]) -> np.ndarray:
        """What the policy says."""
        try:
            return np.asarray(self.policy(obs), np.float64)
        except Exception as error:  # a runtime's errors have no common base
            raise Stop(Cause.POLICY, f"{type(error).__name__}: {error}") from error

    def _observe(self, sensors: Sensors, frame: Frame | None, before: np.ndarray) -> dict[str, np.ndarray]:
        """The observation of a tick, after the targets of the one before."""
        return self._observer.observe(sensors, frame, before)

    def _keep(
        self, sensors: Sensors, frame: Frame | None, obs: dict[str, np.ndarray], targets: np.ndarray, latency: float
    ) -> None:
        row = {"time": sensors.time, "latency": latency, "targets": targets, "up": up(sensors.quat)}
        row |= {"angles": sensors.angles, "velocities": sensors.velocities, "quat": sensors.quat, "gyro": sensors.gyro}
        if sensors.position is not None:
            row["position"] = sensors.position
        if frame is not None:
            row |= {"frame_time": frame.time, "depth": frame.depth.astype(np.float16)}
        if "state" in obs:
            row["state"] = obs["state"]
        self.record.rows.append(row)
        if "position" in row:  # so that a run that is stopped has a distance, too
            self.record.distance = float(np.linalg.norm(row["position"] - self.record.rows[0]["position"]))

    def _hold(self, targets: np.ndarray, until: float) -> None:
        """PD commands to the same targets, clamped anew each time, until the next tick."""
        for _ in range(STILL * self.manifest.pd_hz // self.manifest.policy_hz):
            self._command(targets, self.manifest.kp, self.manifest.kd)
            if self.robot.now() > until - 0.5 / self.manifest.pd_hz:
                return
        raise Stop(Cause.CLOCK, "the robot's clock stands still, or goes much too slowly")

    def _move(self, to: np.ndarray, seconds: float, hold: float) -> None:
        """Goes to a pose in a straight line, and stays there."""
        steps = round(seconds * self.manifest.pd_hz)
        start = self._measure().angles
        for step in range(1, steps + round(hold * self.manifest.pd_hz) + 1):
            part = min(step / steps, 1.0)
            self._command((1 - part) * start + part * to, *MOVE_GAINS)

    def _command(self, targets: np.ndarray, kp: float, kd: float) -> None:
        safe = self.guard.clamp(targets, self._measure(), kp, kd)
        self._commanded = safe
        self.robot.command(safe, kp, kd)

    def _measure(self) -> Sensors:
        self.estop.poll()
        sensors = self.robot.read()
        self.guard.sensors(sensors, self.robot.now())
        return sensors

    def _sink(self) -> None:
        """The damped sit-down, without looking at the sensors, which may be what has failed.

        The legs are drawn in ever more softly, then only damped. Nothing is done to a robot that was not yet commanded.
        """
        if self._commanded is None:
            return
        start, (kp, kd) = self._commanded, DAMPED_GAINS
        steps, limp = (round(seconds * self.manifest.pd_hz) for seconds in (DAMPED, LIMP))
        for step in range(1, steps + limp + 1):
            part = min(step / steps, 1.0)
            targets = np.clip((1 - part) * start + part * SIT, self.manifest.lower, self.manifest.upper)
            try:
                self.robot.command(targets, kp * (1 - part), kd)
            except Exception:  # whatever it is, the robot may take the next one
                time.sleep(1 / self.manifest.pd_hz)

    def _event(self, text: str) -> None:
        """Keeps an event, and tells of it in another thread: a terminal that is gone or stuck stops nothing."""
        when = self.robot.now()
        self.record.events.append((when, text))
        self._voice.post(lambda: self._say(when, text))

    def _flush(self) -> None:
        with contextlib.suppress(Overdue):
            self._voice.call(lambda: None, FLUSH)
        self._voice.close()
        self._worker.close()
