"""MuJoCo's own renderer, off screen; without OpenGL one line says what to install."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator

import mujoco

from loco_mjx.errors import UserError

NO_GL = (
    "{what} needs OpenGL, and MuJoCo finds none that it can use here (MUJOCO_GL is {choice}); on Debian or Ubuntu "
    "install libegl1 libopengl0 libgl1-mesa-dri and leave MUJOCO_GL unset, or do without {what}"
)


@contextlib.contextmanager
def offscreen(model: mujoco.MjModel, rows: int, columns: int, what: str) -> Iterator[mujoco.Renderer]:
    """A renderer of a compiled scene, closed on leaving.

    Args:
        model: compiled from :func:`loco_mjx.scene.mjcf.scene_spec`.
        rows: of the picture.
        columns: of the picture.
        what: the option that asked for pictures, for the complaint.

    Raises:
        UserError: if this machine has no OpenGL that MuJoCo can use.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # without a display, GLFW warns on stderr before it fails
            renderer = mujoco.Renderer(model, rows, columns)
    except Exception:  # each GL library has errors of its own
        choice = repr(os.environ["MUJOCO_GL"]) if "MUJOCO_GL" in os.environ else "unset"
        raise UserError(NO_GL.format(what=what, choice=choice)) from None
    with renderer:
        yield renderer


def check(what: str) -> None:
    """Refuses early, before anything is compiled.

    Raises:
        UserError: as :func:`offscreen`.
    """
    with offscreen(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8, what):
        pass
