"""The robots: what sets one quadruped apart from another, read from its MJCF, and the law of its motors."""

from loco_mjx.robots.registry import DEFAULT, ROBOTS, get_robot, is_path, register_robot
from loco_mjx.robots.robot import LEGS, NJOINT, NQ, NV, PARTS, Robot, Sphere, joint_names

__all__ = [
    "DEFAULT",
    "LEGS",
    "NJOINT",
    "NQ",
    "NV",
    "PARTS",
    "ROBOTS",
    "Robot",
    "Sphere",
    "get_robot",
    "is_path",
    "joint_names",
    "register_robot",
]
