"""A scene as MJCF: every box, wall, step, cylinder and the heightfield a real geom, spheres to be seen only.

Geom groups: 2 is what one sees, 3 what the robot's spheres touch, larger by COLLISION_MARGIN; the ground is both at
once. The robot's own groups are 1 and 4 (mjcf/a1.xml, which also says why contacts have contype 2, conaffinity 1).
"""

from __future__ import annotations

import math

import jax
import mujoco
import numpy as np

from loco_mjx import rotations
from loco_mjx.robots import Robot
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.types import COLLISION_MARGIN, OBSTACLE, STEP, WALL, Boxes, Cylinders, Scene, Spheres, Terrain

SCENE = "_scene"  # suffix of the model's name, after the robot's
SEEN, CONTACT = "seen", "contact"  # default classes, and the suffix of contact geoms' names
KIND_NAMES = {OBSTACLE: "obstacle", WALL: "wall", STEP: "step"}
COLORS: dict[str, tuple[float, float, float, float]] = {
    "obstacle": (0.62, 0.45, 0.31, 1.0),
    "wall": (0.72, 0.74, 0.77, 1.0),
    "step": (0.60, 0.62, 0.60, 1.0),
    "tree": (0.38, 0.27, 0.18, 1.0),
    "sphere": (0.95, 0.77, 0.20, 1.0),
    "goal": (0.86, 0.12, 0.10, 1.0),
    "terrain": (0.52, 0.50, 0.43, 1.0),
}
MILLIMETRES = 1000.0
BASE_THICKNESS = 0.5  # m of heightfield below its lowest vertex
BEYOND = 0.01  # m below the lowest vertex: the floor that catches who walks off a heightfield


def scene_spec(
    scene: Scene, robot: Robot, start: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0, rounded: bool = False
) -> mujoco.MjSpec:
    """A robot in a scene, ready to compile.

    Boxes are named ``obstacle_3``, ``wall_50``, ``step_0`` by their index in the scene, their contact geoms
    ``obstacle_3_contact``; cylinders ``tree_0``, spheres ``sphere_0`` or ``goal``; the ground is ``ground``. Where
    obstacles move, each is a mocap body of the same name (see :func:`place_boxes`). The keyframe ``home`` has the robot
    stand at the start; the camera ``follow`` looks at it from behind, ``depth_camera`` is its own.

    Args:
        scene: one environment's scene (no leading axis).
        robot: which one.
        start: the robot's x and y, m.
        yaw: the robot's heading, rad.
        rounded: heights of the terrain to the millimetre, for a compact file.

    Raises:
        ValueError: MuJoCo's, if the robot's MJCF is damaged.
    """
    spec = mujoco.MjSpec.from_file(str(robot.path))
    spec.modelname = robot.name + SCENE
    _add_looks(spec)
    _add_ground(spec, scene.terrain, rounded)
    _add_boxes(spec, scene.boxes)
    _add_cylinders(spec, scene.cylinders)
    _add_spheres(spec, scene.spheres)
    _place_robot(spec, home_qpos(scene, robot, start, yaw))
    return spec


def scene_xml(scene: Scene, robot: Robot, start: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> str:
    """A robot in a scene as the text of one self-contained MJCF file; arguments as of :func:`scene_spec`."""
    spec = scene_spec(scene, robot, start, yaw, rounded=True)
    spec.compile()  # the writer needs a compiled spec
    return spec.to_xml()


def home_qpos(scene: Scene, robot: Robot, start: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0) -> np.ndarray:
    """(19,) configuration of a robot standing in its default pose on the ground at ``start``, heading ``yaw``."""
    ground = jax.jit(ground_height)(scene, np.float32(start[0]), np.float32(start[1]))
    height = float(ground) + robot.stand_height
    return np.array([*start, height, *rotations.from_yaw(yaw), *robot.default_pose])


def place_boxes(model: mujoco.MjModel, data: mujoco.MjData, scene: Scene) -> None:
    """Moves the mocap bodies of a compiled scene to where ``scene`` has its obstacles now.

    Args:
        model: compiled from :func:`scene_spec` of an earlier moment of the same scene.
        data: written to (``mocap_pos``).
        scene: the boxes' new centres.
    """
    for index, center in enumerate(np.asarray(scene.boxes.center)):
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{KIND_NAMES[OBSTACLE]}_{index}")
        if body >= 0:
            data.mocap_pos[model.body_mocapid[body]] = center


def _add_looks(spec: mujoco.MjSpec) -> None:
    """Sky, materials, the two classes of geoms, and where a viewer starts."""
    kind, pattern = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky = {"type": kind.mjTEXTURE_SKYBOX, "builtin": pattern.mjBUILTIN_GRADIENT, "height": 256 * 6}
    spec.add_texture(name="sky", rgb1=[0.60, 0.74, 0.88], rgb2=[0.92, 0.94, 0.96], width=256, **sky)
    checker = {"type": kind.mjTEXTURE_2D, "builtin": pattern.mjBUILTIN_CHECKER, "height": 256}
    spec.add_texture(name="floor", rgb1=[0.46, 0.48, 0.50], rgb2=[0.52, 0.54, 0.56], width=256, **checker)
    floor = spec.add_material(name="floor", texuniform=True, texrepeat=[1.0, 1.0])
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    for name, color in COLORS.items():
        spec.add_material(name=name, rgba=color, specular=0.1, shininess=0.1)
    seen = spec.add_default(SEEN, spec.default)
    seen.geom.group, seen.geom.contype, seen.geom.conaffinity = 2, 0, 0
    contact = spec.add_default(CONTACT, spec.default)
    contact.geom.group, contact.geom.contype, contact.geom.conaffinity = 3, 2, 1
    contact.geom.rgba = [0.9, 0.3, 0.2, 0.25]
    seen.geom.density = contact.geom.density = 0.0  # the robot's mass is the model's, mocap bodies or not
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.quality.shadowsize = 4096
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1920, 1080
    spec.stat.extent = 4.0


def _add_ground(spec: mujoco.MjSpec, terrain: Terrain | None, rounded: bool) -> None:
    """The plane z = 0, or the heightfield with an unseen floor just below for who walks off it."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    touch = {"contype": 2, "conaffinity": 1}
    seen, contact = spec.find_default(SEEN), spec.find_default(CONTACT)
    if terrain is None:
        spec.worldbody.add_geom(seen, name="ground", type=plane, size=[0, 0, 0.05], material="floor", **touch)
        return
    heights = np.asarray(terrain.heights, np.float64) * MILLIMETRES  # (nx, ny)
    heights = np.round(heights) if rounded else heights
    nx, ny = heights.shape
    lowest = float(heights.min()) / MILLIMETRES
    # MuJoCo scales whatever it is given to 0…1, so that only the range goes into `size`; a level field has none.
    span = max(float(np.ptp(heights)) / MILLIMETRES, 1e-3)
    half_x, half_y = 0.5 * terrain.cell * (nx - 1), 0.5 * terrain.cell * (ny - 1)
    spec.add_hfield(
        name="terrain", size=[half_x, half_y, span, BASE_THICKNESS], nrow=ny, ncol=nx, userdata=heights.T.ravel()
    )
    spec.worldbody.add_geom(
        seen,
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname="terrain",
        pos=[terrain.origin[0] + half_x, terrain.origin[1] + half_y, lowest],
        material="terrain",
        **touch,
    )
    below = [0.0, 0.0, lowest - BEYOND]
    spec.worldbody.add_geom(contact, name="beyond", type=plane, size=[0, 0, 0.05], pos=below)


def _add_boxes(spec: mujoco.MjSpec, boxes: Boxes) -> None:
    """Each box twice, as seen and as touched; obstacles that move as mocap bodies."""
    center, half, kind = np.asarray(boxes.center), np.asarray(boxes.half), np.asarray(boxes.kind)
    contact_half, yaw = np.asarray(boxes.collision_half), np.asarray(boxes.yaw)
    moving = bool(np.any(np.asarray(boxes.velocity) != 0.0))
    for index in range(boxes.count):
        label = KIND_NAMES[int(kind[index])]
        name = f"{label}_{index}"
        pose = {"pos": center[index], "quat": rotations.from_yaw(float(yaw[index]))}
        body = spec.worldbody
        if moving and kind[index] == OBSTACLE:
            body, pose = spec.worldbody.add_body(name=name, mocap=True, **pose), {}
        _add_pair(spec, body, name, label, mujoco.mjtGeom.mjGEOM_BOX, half[index], contact_half[index], pose)


def _add_cylinders(spec: mujoco.MjSpec, cylinders: Cylinders) -> None:
    """Each cylinder twice, as seen and as touched."""
    radius, half_height = np.asarray(cylinders.radius), np.asarray(cylinders.half_height)
    for index, center in enumerate(np.asarray(cylinders.center)):
        size = np.array([radius[index], half_height[index], 0.0])
        contact_size = size + np.array([COLLISION_MARGIN, 0.0, 0.0])
        kind = mujoco.mjtGeom.mjGEOM_CYLINDER
        _add_pair(spec, spec.worldbody, f"tree_{index}", "tree", kind, size, contact_size, {"pos": center})


def _add_pair(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    material: str,
    kind: mujoco.mjtGeom,
    size: np.ndarray,
    contact_size: np.ndarray,
    pose: dict[str, np.ndarray],
) -> None:
    """One geom to see and one to touch."""
    seen, contact = spec.find_default(SEEN), spec.find_default(CONTACT)
    body.add_geom(seen, name=name, type=kind, size=size, material=material, **pose)
    body.add_geom(contact, name=f"{name}_{CONTACT}", type=kind, size=contact_size, **pose)


def _add_spheres(spec: mujoco.MjSpec, spheres: Spheres) -> None:
    """What is to be collected, if it has not been, and the goal's marker."""
    radius, collected, reward = (np.asarray(x) for x in (spheres.radius, spheres.collected, spheres.reward))
    seen = spec.find_default(SEEN)
    for index, center in enumerate(np.asarray(spheres.center)):
        if collected[index]:
            continue
        name, material = (f"sphere_{index}", "sphere") if reward[index] else ("goal", "goal")
        size = [radius[index], 0.0, 0.0]
        spec.worldbody.add_geom(
            seen, name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, pos=center, material=material
        )


def _place_robot(spec: mujoco.MjSpec, qpos: np.ndarray) -> None:
    """The robot at the start, a keyframe that has it stand, light from above, and a camera behind it."""
    trunk = spec.body("trunk")
    trunk.pos, trunk.quat = qpos[:3], qpos[3:7]
    for key in list(spec.keys):
        spec.delete(key)
    spec.add_key(name="home", qpos=qpos)
    spec.stat.center = qpos[:3]
    # The sun goes along with the robot: only around it are there shadows.
    trunk.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        pos=[-1.2, -1.0, 4.0],
        dir=[0.3, 0.25, -1.0],
        castshadow=True,
    )
    trunk.add_camera(
        name="follow",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        pos=[-2.2, 0.0, 1.2],
        quat=_look_along_x(math.radians(-22.0)),
    )


def _look_along_x(pitch: float) -> np.ndarray:
    """Quaternion of a camera that looks along +x, raised by ``pitch``; a camera looks along its own −z, y up."""
    level, raise_by, quat = np.array([0.5, 0.5, -0.5, -0.5]), np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(raise_by, np.array([1.0, 0.0, 0.0]), pitch)
    mujoco.mju_mulQuat(quat, level, raise_by)
    return quat
