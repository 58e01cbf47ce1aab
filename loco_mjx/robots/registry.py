"""Robots by name, and by the path of an MJCF."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from loco_mjx.errors import UnknownNameError, UserError
from loco_mjx.robots.read import read
from loco_mjx.robots.robot import Robot

DEFAULT = "a1"
_PACKAGE = Path(__file__).resolve().parents[1]
PLACES = (_PACKAGE / "assets", _PACKAGE.parent / "mjcf")  # package data of an installed wheel, or of a checkout
ROBOTS: dict[str, Path | None] = {"a1": None, "go1": None, "go2": None}  # None: NAME.xml in one of PLACES


def get_robot(name: str) -> Robot:
    """A robot by its name, or by the path of its MJCF (docs/robots.md), which ends in `.xml`.

    Raises:
        UnknownNameError: if there is no robot of that name.
        UserError: if the MJCF is missing, or does not have what is needed of it; it says what.
    """
    if name.endswith(".xml") or os.sep in name:
        path = Path(name)
        if not path.is_file():
            raise UserError(f"there is no robot '{name}'; accepted: {', '.join(ROBOTS)}, or the path of an MJCF")
        return _cached(path.resolve())
    if name not in ROBOTS:
        raise UnknownNameError("robot", name, ROBOTS)
    return _cached(ROBOTS[name] or _own(name))


def register_robot(name: str, path: Path | str) -> Robot:
    """Gives a name to the robot of an MJCF, in this process; the robot.

    Raises:
        UserError: if the name is taken by another, or the MJCF does not have what is needed of it.
    """
    path = Path(path).resolve()
    if ROBOTS.get(name, path) != path:
        raise UserError(f"robot '{name}' is taken; accepted: another name")
    robot = _cached(path)
    ROBOTS[name] = path
    return robot


def _cached(path: Path) -> Robot:
    return _read(path, path.stat().st_mtime_ns)


@functools.cache
def _read(path: Path, changed: int) -> Robot:
    """Reads a file once for each time that it was changed at."""
    return read(path)


def _own(name: str) -> Path:
    """The MJCF of a robot that comes with the package."""
    places = [place / f"{name}.xml" for place in PLACES]
    for path in places:
        if path.is_file():
            return path
    raise UserError(f"{name}.xml is missing from this installation; looked for {places[0]} and {places[1]}")
