"""Robots by name, and by the path of an MJCF."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from loco_mjx.errors import UserError
from loco_mjx.registry import Registry, caller
from loco_mjx.robots.read import read
from loco_mjx.robots.robot import Robot

DEFAULT = "a1"
_PACKAGE = Path(__file__).resolve().parents[1]
PLACES = (_PACKAGE / "assets", _PACKAGE.parent / "mjcf")  # package data of an installed wheel, or of a checkout
ROBOTS: Registry[Path] = Registry("robot")


def get_robot(name: str) -> Robot:
    """A robot by its name, or by the path of its MJCF (docs/robots.md).

    Raises:
        UnknownNameError: if there is no robot of that name.
        UserError: if the MJCF is missing, or does not have what is needed of it; it says what.
    """
    path = Path(name) if is_path(name) else ROBOTS.find(name)
    if not path.is_file():
        raise UserError(f"there is no robot '{path}'; accepted: {', '.join(ROBOTS)}, or the path of an MJCF")
    return _read(path.resolve(), path.stat().st_mtime_ns)


def is_path(name: str) -> bool:
    """Whether a robot is given by its file."""
    return name.endswith(".xml") or os.sep in name


def register_robot(name: str, path: Path | str) -> Robot:
    """Gives a name to the robot of an MJCF; the robot.

    ``register_robot("mine", Path(__file__).with_name("mine.xml"))`` in a module that `--import` loads makes
    `--robot mine` work.

    Args:
        name: of letters, digits, `.`, `_` and `-`.
        path: of the MJCF; docs/robots.md says what it has to have.

    Raises:
        UserError: if the name is taken or no name, or the MJCF does not fit.
    """
    origin, path = caller(), Path(path).resolve()
    robot = read(path)
    ROBOTS.register(name, path, origin)
    return robot


@functools.cache
def _read(path: Path, changed: int) -> Robot:
    """Reads a file once for each time that it was changed at."""
    return read(path)


def _own(name: str) -> Path:
    """Where the MJCF of a robot is that comes with the package; the checkout's place where it is in none."""
    places = [place / f"{name}.xml" for place in PLACES]
    return next((path for path in places if path.is_file()), places[-1])


for _name in ("a1", "go1", "go2"):
    ROBOTS.register(_name, _own(_name), None)
