"""A robot in C MuJoCo: the full scene with its real geoms, and a depth camera by ray casting."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from loco_mjx.deploy.folder import Camera
from loco_mjx.deploy.robot import Frame, RobotError, Sensors
from loco_mjx.deploy.runner import SIT
from loco_mjx.deploy.terrain_contacts import TerrainContacts
from loco_mjx.deploy.terrain_rays import TerrainRays
from loco_mjx.errors import UserError
from loco_mjx.ranges import Range, check
from loco_mjx.robots import LEGS, NJOINT, NQ

SEEN_GROUP, HIDDEN_GROUP = 2, 5  # geom groups: what the camera sees, and what has been collected
GROUND_GROUP = 1  # heightfields, whose rays are cast apart; viewers show it, as they do SEEN_GROUP
COLLECT_RADIUS = 0.2  # m, in xy
MEMORY = 0.2  # s of measurements and images kept, and so the longest latency
Latency = Annotated[float, Range(0, MEMORY)]
Deviation = Annotated[float, Range(0, 10)]


@dataclass(frozen=True)
class Imperfections:
    """What real sensors do.

    Attributes:
        sensor_latency: s, of everything but the camera.
        frame_latency: s, from exposure to delivery.
        angle_noise: rad, standard deviation.
        gyro_noise: rad/s, standard deviation.
        blind_pixels: of each image that read far.
        dropped: part of the images that never arrive.
    """

    sensor_latency: Latency = 0.0
    frame_latency: Latency = 0.0
    angle_noise: Deviation = 0.0
    gyro_noise: Deviation = 0.0
    blind_pixels: Annotated[int, Range(0, 1024 * 1024)] = 0
    dropped: Annotated[float, Range(0, 1)] = 0.0


class MujocoRobot:
    """The robot protocol on a compiled scene; its clock is the simulation's."""

    def __init__(
        self,
        model: Any,
        camera: Camera | None,
        imperfections: Imperfections | None = None,
        seed: int = 0,
        lying: bool = True,
        between: Callable[[Any, Any], None] | None = None,
        prisms: bool = False,
        policy_hz: int = 25,
    ) -> None:
        """Puts the robot at the scene's keyframe.

        Args:
            model: mujoco.MjModel of a scene (loco_mjx/scene/mjcf.py), or of a robot's own MJCF with a ground.
            camera: of the policy; None renders nothing.
            imperfections: of the sensors; None for none.
            seed: of their noise.
            lying: start on the belly instead of standing.
            between: called with the model and its data every control step, to move what moves.
            prisms: leave C's own contacts with a heightfield as they are; see loco_mjx/deploy/terrain_contacts.py.
            policy_hz: images per second, and how often what moves is moved.

        Raises:
            UserError: if the model is no scene with a robot, its rates are others, or an imperfection is none.
        """
        import mujoco

        self._mujoco, self.model, self.data = mujoco, model, mujoco.MjData(model)
        self._dt = float(model.opt.timestep)
        self._substeps = round(1 / (policy_hz * self._dt))
        whole = abs(self._substeps * policy_hz * self._dt - 1) < 1e-6
        if model.nq != NQ or model.nu != NJOINT or not whole or model.nkey < 1:
            raise UserError("the MJCF is no scene with a robot; `loco-mjx scene --out FILE.xml` writes one")
        self.name = model.names[: model.names.index(b"\0")].decode().removesuffix("_scene")
        self.camera, self.faults = camera, imperfections or Imperfections()
        check(self.faults, "imperfections")
        self._random, self._between, self._steps = np.random.default_rng(seed), between, 0
        self._frames: deque[Frame] = deque(maxlen=round(MEMORY * policy_hz) + 2)
        self._sensors: deque[Sensors] = deque(maxlen=round(MEMORY / self._dt) + 2)
        self._feet = [model.geom(f"{leg}_foot_sphere").id for leg in LEGS]
        self._contacts = TerrainContacts(model, prisms)
        self._terrain = None if camera is None else TerrainRays(model, SEEN_GROUP, GROUND_GROUP)
        self._place(lying)
        self._sense()
        self._expose(first=True)

    # The protocol -----------------------------------------------------------------------------------------------------

    def now(self) -> float:
        """Simulated time, s."""
        return self._steps * self._dt

    def read(self) -> Sensors:
        """The measurements of `sensor_latency` ago."""
        return _newest(self._sensors, self.now() - self.faults.sensor_latency)

    def depth(self) -> Frame:
        """The newest image that has arrived."""
        if not self._frames:
            raise RobotError("there is no camera")
        return _newest(self._frames, self.now() - self.faults.frame_latency)

    def command(self, targets: np.ndarray, kp: float, kd: float) -> None:
        """One physics step under the PD law."""
        self._step(kp * (targets - self.data.qpos[7:]) - kd * self.data.qvel[6:])

    def drive(
        self, angles: np.ndarray, velocities: np.ndarray, kp: np.ndarray, kd: np.ndarray, torque: np.ndarray
    ) -> None:
        """One physics step under the motors' law."""
        self._step(torque + kp * (angles - self.data.qpos[7:]) + kd * (velocities - self.data.qvel[6:]))

    def close(self) -> None:
        """There is nothing to let go of."""

    # Details ----------------------------------------------------------------------------------------------------------

    def _step(self, torque: np.ndarray) -> None:
        self.data.ctrl[:] = np.clip(torque, *self.model.actuator_ctrlrange.T)
        self._contacts.step(self.data)
        self._steps += 1
        self._sense()
        if self._steps % self._substeps == 0:
            self._collect()
            if self._between is not None:
                self._between(self.model, self.data)
            self._expose()

    def _place(self, lying: bool) -> None:
        self._mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        if lying:
            standing = self._lowest_foot()
            self.data.qpos[7:] = SIT
            self.data.qpos[2] -= self._lowest_foot() - standing
        self._mujoco.mj_forward(self.model, self.data)

    def _lowest_foot(self) -> float:
        """Height of the lowest foot's centre, m."""
        self._mujoco.mj_kinematics(self.model, self.data)
        return float(min(self.data.geom(f"{leg}_foot_sphere").xpos[2] for leg in LEGS))

    def _sense(self) -> None:
        noise, faults = self._random.normal, self.faults
        angles, gyro = self.data.qpos[7:].copy(), self.data.qvel[3:6].copy()
        # noise = N(0, σ)
        angles += noise(0.0, faults.angle_noise, NJOINT) if faults.angle_noise else 0.0
        gyro += noise(0.0, faults.gyro_noise, 3) if faults.gyro_noise else 0.0
        quat, position = self.data.qpos[3:7].copy(), self.data.qpos[:3].copy()
        feet = np.isin(self._feet, self.data.contact.geom[: self.data.ncon])
        self._sensors.append(Sensors(self.now(), angles, self.data.qvel[6:].copy(), quat, gyro, position, feet))

    def _expose(self, first: bool = False) -> None:
        if self.camera is None or (not first and self._random.uniform() < self.faults.dropped):
            return
        image = self._render()
        if self.faults.blind_pixels:
            pixels = self._random.integers(0, image.size, self.faults.blind_pixels)  # +U{0..size − 1}
            image.ravel()[pixels] = self.camera.far
        self._frames.append(Frame(self.now(), image))

    def _render(self) -> np.ndarray:
        """(height, width) planar depth, m, of what is not the robot."""
        from loco_mjx.depth import c_mujoco

        assert self.camera is not None
        self._mujoco.mj_kinematics(self.model, self.data)  # after a step positions are still those before it
        where = (self.data.qpos, self.camera.offset, self.camera)
        return c_mujoco.cast(self.model, self.data, *where, groups=(SEEN_GROUP,), terrain=self._terrain)

    def _collect(self) -> None:
        """Spheres that the robot has reached are seen no more."""
        for geom in range(self.model.ngeom):
            if self.model.geom_group[geom] == SEEN_GROUP and self.model.geom(geom).name.startswith("sphere_"):
                away = self.data.geom_xpos[geom, :2] - self.data.qpos[:2]
                if np.hypot(*away) < COLLECT_RADIUS:
                    self.model.geom_group[geom] = HIDDEN_GROUP


def _newest(kept: deque[Any], latest: float) -> Any:
    """The newest of what was measured no later than a time; the oldest there is before that."""
    for item in reversed(kept):
        if item.time <= latest + 1e-9:
            return item
    return kept[0]
