"""The policy's observation from what the robot measures: the histories of training, newest first, in NumPy."""

from __future__ import annotations

import numpy as np

from loco_mjx import rotations
from loco_mjx.deploy.depth_hold import DepthHold
from loco_mjx.deploy.description import DEPTH, STATE
from loco_mjx.deploy.folder import Camera, Manifest
from loco_mjx.deploy.robot import Frame, Sensors
from loco_mjx.errors import UserError
from loco_mjx.sensors import SENSORS, Readings, measure


def check_readable(manifest: Manifest, position_known: bool) -> None:
    """Whether a robot measures what the policy reads.

    Args:
        manifest: of the policy.
        position_known: whether the robot knows where it is in the world.

    Raises:
        UserError: naming what it reads that is not measured, and how to train a policy without it.
    """
    if manifest.reads("goal"):
        raise UserError(
            "the policy reads the goal, which no robot measures; train one with --env.observation.goal False"
        )
    unknown = [field.name for field in manifest.fields if field.name not in SENSORS]
    if unknown:
        raise UserError(f"the policy reads '{unknown[0]}', which no robot measures; accepted: {', '.join(SENSORS)}")
    walks = manifest.controller.name == "mpc"  # whose legs tell how fast it goes
    for name, measured in (("displacement", position_known), ("velocity", position_known or walks)):
        if manifest.reads(name) and not measured:
            raise UserError(
                f"the policy reads the base's {name}, which this robot does not measure; "
                f"train one with --env.observation.{name} False"
            )


def up(quat: np.ndarray) -> float:
    """The z of the trunk's up axis, of a quaternion as it is measured: 1 upright, 0 on its side."""
    return float(rotations.upright(rotations.unit(quat)))


def encode(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth in metres to the policy's input."""
    clipped = np.clip(depth, camera.near, camera.far)
    return ((np.sqrt(np.log1p(clipped)) - camera.code_offset) / camera.code_scale).astype(np.float32)


class Observer:
    """Keeps the histories of one run. At its start they hold copies of the first measurement, as after a reset."""

    def __init__(self, manifest: Manifest) -> None:
        """Prepares empty histories."""
        self._manifest = manifest
        self._history: dict[str, np.ndarray] = {}
        self._stack: np.ndarray | None = None
        self._held = DepthHold(manifest.hold)
        self._position: np.ndarray | None = None
        self._heading: float | None = None

    def observe(
        self, sensors: Sensors, frame: Frame | None, targets: np.ndarray | None, velocity: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """The observation of the next tick.

        Args:
            sensors: measured now.
            frame: the newest image; None if the policy reads none.
            targets: (12,) the last tick's joint targets, rad; the default pose before the first; None without any.
            velocity: (3,) of the trunk, the mean since the last tick, world frame, m/s; None: from where the robot is.

        In the world's frame, as policies know it, they set out along +x. A robot that does not know where it is has an
        IMU whose yaw is of any frame: there +x is where it looks in the first observation.

        Returns:
            `state` (n,) and `depth` (height, width, frames), whichever the policy reads; float32.
        """
        obs = {}
        if self._manifest.fields:
            self._push(self._measured(sensors, targets, velocity))
            parts = [self._history[field.name].ravel() for field in self._manifest.fields]
            obs[STATE] = np.concatenate(parts).astype(np.float32)
        if frame is not None:
            obs[DEPTH] = self._seen(frame)
        return obs

    def _measured(
        self, sensors: Sensors, targets: np.ndarray | None, velocity: np.ndarray | None
    ) -> dict[str, np.ndarray]:
        displacement, quat = None, rotations.unit(sensors.quat)
        if sensors.position is None:  # nor does it know where the course leads: along where it looked at first
            if self._heading is None:
                self._heading = float(rotations.yaw(quat))
            quat = rotations.turned(quat, -self._heading)
            if velocity is not None:
                velocity = rotations.matrix(rotations.from_yaw(-self._heading)) @ velocity
        else:
            displacement = sensors.position - (sensors.position if self._position is None else self._position)
            self._position = sensors.position
            velocity = displacement * self._manifest.policy_hz if velocity is None else velocity
        readings = Readings(
            quat=quat,
            gyro=sensors.gyro,
            angles=sensors.angles,
            last_action=None if targets is None else targets - self._manifest.default_pose,
            displacement=displacement,
            velocity=velocity,
        )
        return measure(readings, [field.name for field in self._manifest.fields], np)

    def _push(self, now: dict[str, np.ndarray]) -> None:
        for field in self._manifest.fields:
            past = self._history.get(field.name, np.tile(now[field.name], (field.frames, 1)))
            self._history[field.name] = np.concatenate([now[field.name][None], past[:-1]])

    def _seen(self, frame: Frame) -> np.ndarray:
        """The stack with the newest image in front; held for as many ticks as in training."""
        camera = self._manifest.camera
        assert camera is not None
        newest = encode(frame.depth, camera)[..., None]
        past = np.repeat(newest, camera.frames, axis=-1) if self._stack is None else self._stack
        self._stack = np.concatenate([newest, past[..., :-1]], axis=-1)
        return self._held(self._stack)
