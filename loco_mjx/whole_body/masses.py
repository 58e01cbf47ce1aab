"""Mass, centre of mass and inertia of a whole robot in its standing pose, from its MJCF; neither MuJoCo nor JAX."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loco_mjx.robots import LEGS, PARTS, Robot
from loco_mjx.robots.document import Document, Element
from loco_mjx.whole_body.arrays import rotation


class Masses(NamedTuple):
    """Of a robot, or of a link.

    Attributes:
        mass: kg.
        center: (3,) of mass, m, in the trunk's frame, or the link's.
        inertia: (3, 3) about it, along that frame's axes, kg m².
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray


def masses(robot: Robot) -> Masses:
    """Of a robot in its default pose.

    Raises:
        UserError: if its MJCF does not give the inertia of each link.
    """
    document = Document(robot.path)
    placed = [_turned(_link(document, "trunk"), np.eye(3), np.zeros(3))]
    for leg, name in enumerate(LEGS):
        place, turn = np.zeros(3), np.eye(3)
        for part, kind in enumerate(PARTS):
            body = document.named("body", f"{name}_{kind}")
            place = place + turn @ np.array(body.numbers("pos", 3, (0.0, 0.0, 0.0)))
            turn = turn @ _about(0 if kind == "hip" else 1, robot.default_pose[3 * leg + part])
            placed.append(_turned(_link(document, body.name), turn, place))
    mass = sum(one.mass for one in placed)
    center = np.sum([one.mass * one.center for one in placed], axis=0) / mass
    inertia = np.sum([one.inertia + one.mass * _spread(one.center - center) for one in placed], axis=0)
    return Masses(mass, center, inertia)


def _about(axis: int, angle: float) -> np.ndarray:
    """(3, 3) rotation about the x or the y axis."""
    vector = np.zeros(4)
    vector[0], vector[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return rotation(vector)


def _spread(offset: np.ndarray) -> np.ndarray:
    """Inertia of a unit mass at an offset (3,)."""
    return offset @ offset * np.eye(3) - np.outer(offset, offset)


def _turned(link: Masses, turn: np.ndarray, place: np.ndarray) -> Masses:
    """A link's, in a frame in which the link is at a place and turned."""
    return Masses(link.mass, place + turn @ link.center, turn @ link.inertia @ turn.T)


def _link(document: Document, name: str) -> Masses:
    inertial: Element = next(iter(document.named("body", name).children("inertial")), document.named("body", name))
    mass = inertial.numbers("mass", 1)[0]
    center = np.array(inertial.numbers("pos", 3))
    if inertial.get("fullinertia") is not None:
        xx, yy, zz, xy, xz, yz = inertial.numbers("fullinertia", 6)
        return Masses(mass, center, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    turn = rotation(np.array(inertial.numbers("quat", 4, (1.0, 0.0, 0.0, 0.0))))
    return Masses(mass, center, turn @ np.diag(inertial.numbers("diaginertia", 3)) @ turn.T)
