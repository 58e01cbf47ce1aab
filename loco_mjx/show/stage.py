"""A rollout's scene in C MuJoCo, posed but never stepped: for its renderer and for the browser."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from loco_mjx import rotations
from loco_mjx.robots import Robot
from loco_mjx.scene.mjcf import place_boxes, scene_spec
from loco_mjx.scene.types import Scene
from loco_mjx.show.rollout import Moment

HIDDEN_GROUP = 5  # of geoms; viewers draw 0, 1, 2
FIELD = 45.0  # degrees, of MuJoCo's free camera, vertically
EDGE = 2.0  # degrees between what is kept in view and its edge
BELOW = 0.3  # m from trunk to feet
CLIMB = 1.5  # times as far from the robot where there is a goal to see as well
FADE = 0.15  # rad from the view's side within which a goal begins to be looked up to
SMOOTHING = 0.08  # of the way that the camera makes up per control step


class Stage:
    """One episode's scene, compiled, as of its moments."""

    def __init__(self, moment: Moment, robot: Robot) -> None:
        """Compiles the scene of an episode's first moment, with the robot in it."""
        self.model: mujoco.MjModel = scene_spec(moment.scene, robot).compile()
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


def goal_top(scene: Scene) -> np.ndarray | None:
    """(3,) the highest point of the goal's marker, m; None where a scene marks no goal."""
    marks = ~np.asarray(scene.spheres.reward, bool)
    if not marks.any():
        return None
    index = int(marks.argmax())
    return np.asarray(scene.spheres.center)[index] + np.array([0.0, 0.0, float(scene.spheres.radius[index])])


def raise_to(camera: mujoco.MjvCamera, robot: np.ndarray, top: np.ndarray, ratio: float) -> None:
    """Tilts a camera up, where it stands, until it sees a point ahead; the robot stays in view.

    Args:
        camera: looks at `lookat` from `distance`; its elevation and `lookat` are changed.
        robot: (3,) its trunk, m.
        top: (3,) the point, m; left alone when it is beside the view.
        ratio: width over height of the view.
    """
    ahead = np.array([math.cos(math.radians(camera.azimuth)), math.sin(math.radians(camera.azimuth)), 0.0])
    up = np.array([0.0, 0.0, 1.0])

    def along(elevation: float) -> np.ndarray:
        return camera.distance * (math.cos(elevation) * ahead + math.sin(elevation) * up)

    before = math.radians(camera.elevation)
    eye = np.array(camera.lookat) - along(before)

    def angle(point: np.ndarray) -> float:
        """Above the horizon, in the vertical plane of the camera's axis."""
        return math.atan2(point[2] - eye[2], max(float((point - eye) @ ahead), 1e-3))

    half, margin = math.radians(FIELD / 2), math.radians(EDGE)
    lowest = angle(robot - BELOW * up) - margin + half  # of the elevations that keep the robot in view
    wanted = max(before, min(angle(top) + margin - half, max(lowest, before)))
    side = np.arctan2(*((top - eye)[:2] @ np.stack([[-ahead[1], ahead[0]], ahead[:2]], axis=1)))
    inside = math.atan(math.tan(half) * ratio) - abs(float(side))
    elevation = before + (wanted - before) * min(max(inside / FADE, 0.0), 1.0)
    camera.elevation, camera.lookat[:] = math.degrees(elevation), eye + along(elevation)


class Follower:
    """A camera behind the robot that follows it smoothly, and looks up to a goal that lies ahead."""

    def __init__(self, distance: float = 2.6, elevation: float = -24.0, ratio: float = 16 / 9) -> None:
        """Distance in m and elevation in degrees, of the camera to what it looks at; width over height of its view."""
        self.camera = mujoco.MjvCamera()
        self._distance, self._elevation, self._ratio = distance, elevation, ratio
        self._place: np.ndarray | None = None

    def follow(self, moment: Moment) -> mujoco.MjvCamera:
        """The camera at a moment; at an episode's first step it is behind the robot at once."""
        yaw = float(rotations.yaw(moment.qpos[3:7]))
        heading = np.array([math.cos(yaw), math.sin(yaw)])
        target = np.concatenate([moment.qpos[:3], heading])
        if self._place is None or moment.step == 0:
            self._place = target
        self._place = self._place + SMOOTHING * (target - self._place)
        top = goal_top(moment.scene)
        self.camera.distance = self._distance * (1.0 if top is None else CLIMB)
        self.camera.elevation = self._elevation
        self.camera.lookat[:] = [moment.qpos[0] + 0.5, moment.qpos[1], self._place[2]]
        self.camera.azimuth = math.degrees(math.atan2(self._place[4], self._place[3])) + 12.0
        if top is not None:
            raise_to(self.camera, moment.qpos[:3], top, self._ratio)
        return self.camera
