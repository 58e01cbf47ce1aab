"""What keeps the robot and those beside it whole: clamps on every command, and reasons to sit down."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.observer import up
from loco_mjx.deploy.plausible import Stuck, Unchanged, impossible, malformed, unusable
from loco_mjx.deploy.robot import Frame, Sensors
from loco_mjx.ranges import Range, check
from loco_mjx.robots import NJOINT
from loco_mjx.robots.motor import MotorCommand

Seconds = Annotated[float, Range(0, 5, above=True)]
AHEAD = 0.005  # s by which a measurement's clock may be ahead
FRAMES = 4  # images may stay the same this much longer than other measurements


class Cause(StrEnum):
    """Why a run ended before its time."""

    JOINT_LIMIT = "joint limit"
    TORQUE = "torque limit"
    TILT = "tilt"
    STALE_SENSORS = "stale sensors"
    STALE_CAMERA = "stale camera"
    IMPOSSIBLE_IMAGE = "impossible image"
    NONFINITE_SENSORS = "non-finite sensors"
    IMPOSSIBLE_SENSORS = "impossible sensors"
    NONFINITE_ACTION = "non-finite action"
    DEADLINE = "missed deadlines"
    CLOCK = "clock"
    POLICY = "policy failed"
    SOLVER = "programs not solved"
    FAILURE = "software failure"
    ESTOP = "emergency stop"
    ROBOT = "robot does not answer"


class Stop(Exception):  # noqa: N818 - it is no error
    """Raised to end a run."""

    def __init__(self, cause: Cause, detail: str) -> None:
        super().__init__(f"{cause}: {detail}")
        self.cause, self.detail = cause, detail


@dataclass(frozen=True)
class Limits:
    """When a run ends.

    Attributes:
        min_up: z of the trunk's up axis; training ends an episode at 0.6.
        joint_margin: rad beyond a joint's limit at which it counts as broken.
        saturated: s for which a joint may ask for more than its torque limit without a break.
        sensor_age: s.
        frame_age: s; a camera at 25 Hz or more may lose a few frames.
        missed: deadlines in a row, and ticks by which one may be overdue.
        frozen: s for which measurements, or an image that shows anything, may stay the same to the last bit; images
            four times as long; a single joint if its target moves meanwhile.
        unsolved: quadratic programs of the whole-body controller in a row that may go unsolved.
    """

    min_up: Annotated[float, Range(0, 1, above=True, below=True)] = 0.5
    joint_margin: Annotated[float, Range(0, 1, above=True)] = 0.1
    saturated: Seconds = 0.5
    sensor_age: Seconds = 0.05
    frame_age: Seconds = 0.25
    missed: Annotated[int, Range(1, 100)] = 5
    frozen: Seconds = 0.5
    unsolved: Annotated[int, Range(1, 100)] = 5

    def check(self) -> None:
        """Refuses limits that would never end a run.

        Raises:
            UserError: naming the limit and what is accepted.
        """
        check(self, "limits")


class Guard:
    """Checks what is measured and clamps what is commanded; its methods raise Stop."""

    def __init__(self, manifest: Manifest, limits: Limits) -> None:
        limits.check()
        self.limits = limits
        self._now = -math.inf
        self._commanded = math.inf  # time of the last measurement for which there was a command, s
        self._joints, self._trunk, self._image = Unchanged(), Unchanged(), Unchanged()
        self._encoders = Stuck()
        self._manifest = manifest
        self._saturated = np.zeros(NJOINT)  # s
        self._missed: dict[str, int] = {}
        self.misses = 0
        self.clamped = 0  # commands that were changed

    def sensors(self, sensors: Sensors, now: float) -> None:
        """Refuses measurements that are old, impossible, or of a robot that falls or is bent beyond its limits."""
        if wrong := malformed(sensors):
            raise Stop(Cause.NONFINITE_SENSORS, wrong)
        self._clock(now, sensors.time)
        age = now - sensors.time
        if age > self.limits.sensor_age:
            raise Stop(Cause.STALE_SENSORS, f"{1000 * age:.0f} ms old")
        self._frozen(sensors)
        if wrong := impossible(sensors, self._manifest.joints):
            raise Stop(Cause.IMPOSSIBLE_SENSORS, wrong)
        if up(sensors.quat) < self.limits.min_up:
            raise Stop(Cause.TILT, f"{np.degrees(np.arccos(np.clip(up(sensors.quat), -1, 1))):.0f}° from upright")
        beyond = np.maximum(self._manifest.lower - sensors.angles, sensors.angles - self._manifest.upper)
        worst = int(np.argmax(beyond))
        if beyond[worst] > self.limits.joint_margin:
            raise Stop(Cause.JOINT_LIMIT, f"{self._manifest.joints[worst]} at {sensors.angles[worst]:.2f} rad")

    def frame(self, frame: Frame, now: float) -> None:
        """Refuses an image that is old or none of the policy's camera."""
        if wrong := unusable(frame, self._manifest.camera):
            raise Stop(Cause.IMPOSSIBLE_IMAGE, wrong)
        self._clock(now, frame.time)
        age = now - frame.time
        if age > self.limits.frame_age:
            raise Stop(Cause.STALE_CAMERA, f"{1000 * age:.0f} ms old")
        camera = self._manifest.camera
        same = self._image.seconds(frame.depth, now)
        # Where nothing is in sight, all of an image is the far clip, and stays so.
        shows = camera is None or bool(np.any(frame.depth < camera.far))
        if shows and same > FRAMES * self.limits.frozen:
            raise Stop(Cause.STALE_CAMERA, f"the image has not changed for {same:.2f} s")

    def _clock(self, now: float, measured: float) -> None:
        """Refuses a clock that goes back, and what was measured after now."""
        if not now >= self._now:
            raise Stop(Cause.CLOCK, f"the robot's clock went from {self._now:.3f} s to {now:.3f} s")
        if measured > now + AHEAD:
            raise Stop(Cause.CLOCK, f"a measurement is from {1000 * (measured - now):.0f} ms in the future")
        self._now = now

    def _frozen(self, sensors: Sensors) -> None:
        """Refuses measurements whose time goes on and that stay the same."""
        parts = {
            "joints": self._joints.seconds(np.concatenate([sensors.angles, sensors.velocities]), sensors.time),
            "orientation and rates": self._trunk.seconds(np.concatenate([sensors.quat, sensors.gyro]), sensors.time),
        }
        for name, same in parts.items():
            if same > self.limits.frozen:
                raise Stop(Cause.STALE_SENSORS, f"the {name} have not changed for {same:.2f} s")

    def _stuck(self, sensors: Sensors, targets: np.ndarray) -> None:
        """Refuses a joint that measures the same while it is told to move; the others' changes hide it above."""
        same = self._encoders.seconds(sensors, targets)
        worst = int(np.argmax(same))
        if same[worst] > self.limits.frozen:
            name = self._manifest.joints[worst]
            raise Stop(Cause.STALE_SENSORS, f"{name} has not changed for {same[worst]:.2f} s, but its target has")

    def action(self, targets: np.ndarray) -> None:
        """Refuses what is not as many numbers as the controller takes, of joint targets 12."""
        wanted = (self._manifest.controller.size,)
        if targets.shape != wanted:
            raise Stop(Cause.POLICY, f"its output has shape {targets.shape}, not {wanted}")
        if not np.all(np.isfinite(targets)):
            raise Stop(Cause.NONFINITE_ACTION, "the policy's output is not a number")

    def deadline(self, latency: float, period: float, of: str = "tick") -> None:
        """Counts missed deadlines, those in a row by what has them."""
        late = latency > period
        self.misses += late
        row = self._missed[of] = self._missed.get(of, 0) + 1 if late else 0
        if row >= self.limits.missed:
            raise Stop(Cause.DEADLINE, f"{row} in a row, the last by {1000 * (latency - period):.0f} ms")

    def clamp(self, targets: np.ndarray, sensors: Sensors, kp: float, kd: float) -> np.ndarray:
        """(12,) targets such that the PD law asks for no more than the torque limit, and within the joints' limits.

        The joints' limits come last: whatever is measured, no command is beyond them. Raises Stop for a joint that
        asks for too much for too long, or that measures the same while its target moves.
        """
        m = self._manifest
        within = np.clip(targets, m.lower, m.upper)
        self._stuck(sensors, within)
        torque = kp * (within - sensors.angles) - kd * sensors.velocities
        over = self._over(torque, sensors.time)
        allowed = np.clip(torque, -m.torque_limit, m.torque_limit)
        bounded = np.where(over, sensors.angles + (allowed + kd * sensors.velocities) / kp, within)
        safe = np.clip(bounded, m.lower, m.upper)
        self.clamped += int(np.any(safe != targets))
        return safe

    def motors(self, command: MotorCommand, sensors: Sensors) -> MotorCommand:
        """A command such that its law asks for no more than the torque limit, its angles within the joints' limits.

        Raises Stop for a joint that asks for too much for too long.
        """
        m = self._manifest
        if not all(np.all(np.isfinite(part)) for part in command):
            raise Stop(Cause.NONFINITE_ACTION, "the command is not a number")
        angles = np.clip(command.angles, m.lower, m.upper)
        asked = command.torque + command.kp * (angles - sensors.angles)
        asked = asked + command.kd * (command.velocities - sensors.velocities)
        self._over(asked, sensors.time)
        excess = asked - np.clip(asked, -m.torque_limit, m.torque_limit)
        self.clamped += int(np.any(excess) or np.any(angles != command.angles))
        return command._replace(angles=angles, torque=command.torque - excess)

    def _over(self, torque: np.ndarray, time: float) -> np.ndarray:
        """Which joints (12,) ask for more than the torque limit, at a measurement's time, s.

        Raises:
            Stop: for one that does for too long.
        """
        m = self._manifest
        over = np.abs(torque) > m.torque_limit
        # A command holds until the next one, however long that takes; what has no time of its own takes its turn.
        least = 1 / m.pd_hz
        elapsed = float(np.clip(time - self._commanded, least, max(self.limits.sensor_age, least)))
        self._commanded = time if math.isinf(self._commanded) else max(time, self._commanded + elapsed)
        self._saturated = np.where(over, self._saturated + elapsed, 0.0)
        worst = int(np.argmax(self._saturated))
        if self._saturated[worst] > self.limits.saturated:
            raise Stop(Cause.TORQUE, f"{m.joints[worst]} asks for {torque[worst]:.0f} N·m")
        return over
