"""A rollout's scene in C MuJoCo, posed but never stepped: for its renderer and for the browser."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from loco_mjx.scene.mjcf import place_boxes, scene_spec
from loco_mjx.show.rollout import Moment

HIDDEN_GROUP = 5  # of geoms; viewers draw 0, 1, 2
SMOOTHING = 0.08  # of the way that the camera makes up per control step


class Stage:
    """One episode's scene, compiled, as of its moments."""

    def __init__(self, moment: Moment) -> None:
        """Compiles the scene of an episode's first moment."""
        self.model: mujoco.MjModel = scene_spec(moment.scene).compile()
        self.data = mujoco.MjData(self.model)
        self.spheres = {
            index: geom
            for index in range(moment.scene.spheres.count)
            if (geom := mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, f"sphere_{index}")) >= 0
        }
        self.pose(moment)

    def pose(self, moment: Moment) -> None:
        """Robot, moving obstacles and collected spheres as of a moment of this episode."""
        self.data.qpos[:] = moment.qpos
        place_boxes(self.model, self.data, moment.scene)
        collected = np.asarray(moment.scene.spheres.collected)
        for index, geom in self.spheres.items():
            self.model.geom_group[geom] = HIDDEN_GROUP if collected[index] else 2
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


class Follower:
    """A camera behind the robot that follows it smoothly."""

    def __init__(self, distance: float = 2.6, elevation: float = -24.0) -> None:
        """Distance in m and elevation in degrees, of the camera to what it looks at."""
        self.camera = mujoco.MjvCamera()
        self.camera.distance, self.camera.elevation = distance, elevation
        self._place: np.ndarray | None = None

    def follow(self, moment: Moment) -> mujoco.MjvCamera:
        """The camera at a moment; at an episode's first step it is behind the robot at once."""
        w, x, y, z = moment.qpos[3:7]
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        heading = np.array([math.cos(yaw), math.sin(yaw)])
        target = np.concatenate([moment.qpos[:3], heading])
        if self._place is None or moment.step == 0:
            self._place = target
        self._place = self._place + SMOOTHING * (target - self._place)
        self.camera.lookat[:] = [moment.qpos[0] + 0.5, moment.qpos[1], self._place[2]]
        self.camera.azimuth = math.degrees(math.atan2(self._place[4], self._place[3])) + 12.0
        return self.camera
