"""`loco-mjx scene`: writes a generated scene as MJCF, and a picture of it beside what the depth camera sees."""

from __future__ import annotations

import ctypes.util
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from loco_mjx.cli.parse import parse
from loco_mjx.errors import UserError
from loco_mjx.ranges import Range
from loco_mjx.robots import DEFAULT, Robot, get_robot

if TYPE_CHECKING:
    import numpy as np

    from loco_mjx.scene.types import Scene

PROG = "loco-mjx scene"
LARGEST_SEED = 2**32 - 1
PICTURE = (640, 960)  # rows and columns of the third-person view


@dataclass(frozen=True)
class Options:
    """Writes one of a task's scenes, with the robot in it, as MJCF and as a picture."""

    task: str = "thin"
    """Which task's scene."""
    robot: str = DEFAULT
    """Which robot stands in it, by name or the path of its MJCF."""
    seed: Annotated[int, Range(0, LARGEST_SEED)] = 0
    """Which of its scenes; the same seed gives the same scene."""
    out: Path | None = None
    """File for the MJCF; any MuJoCo viewer opens it by itself."""
    png: Path | None = None
    """File for a picture: the scene from behind the robot, and its depth image."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: as :func:`scene`.
    """
    options = parse(Options, args, PROG, names=("tasks", "robots"))
    from loco_mjx.run import machine

    if options.png is not None:
        choose_gl()
    machine.set_up()
    scene(options.task, options.seed, options.out, options.png, options.robot)
    return 0


def scene(
    task: str = "thin", seed: int = 0, out: Path | None = None, png: Path | None = None, robot: str = DEFAULT
) -> None:
    """Writes one of a task's scenes, with the robot standing at its start.

    Args:
        task: the task's name.
        seed: which of its scenes, 0 … 2³² − 1.
        out: file for the MJCF; replaced if it exists.
        png: file for the picture; replaced if it exists. Needs OpenGL; without it the MJCF is written all the same.
        robot: which robot stands in it, by name or the path of its MJCF.

    Raises:
        UserError: if the task or the robot is unknown, the seed out of range, there is nothing to write or nowhere to
            write it, or OpenGL is missing.
    """
    import jax

    from loco_mjx.physics.compiled import compiled
    from loco_mjx.scene.mjcf import scene_xml
    from loco_mjx.scene.tasks import get_task

    generate, body = get_task(task).generate, get_robot(robot)
    compiled(body)  # refuses one that does not fit
    if not 0 <= seed <= LARGEST_SEED:
        raise UserError(f"seed is {seed}; accepted: 0 to {LARGEST_SEED}")
    if out is None and png is None:
        raise UserError("nothing to write; accepted: --out FILE.xml, --png FILE.png, or both")
    for path in (out, png):
        _check_writable(path)
    world = jax.jit(generate)(jax.random.PRNGKey(seed))
    if out is not None:
        _write(out, scene_xml(world, body).encode())
    if png is not None:
        _write(png, picture(world, body, f"{task}, seed {seed}"))


def _check_writable(path: Path | None) -> None:
    if path is not None and path.is_dir():
        raise UserError(f"'{path}' is a directory; accepted: the name of a file")
    if path is not None and not path.parent.is_dir():
        raise UserError(f"there is no directory '{path.parent}' to write '{path.name}' into")


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise UserError(f"cannot write '{path}': {error.strerror}") from None
    print(f"wrote {path} ({len(content) // 1024} KB)")


def choose_gl() -> None:
    """Has MuJoCo render without a display, unless the user chose otherwise; to be called before importing MuJoCo.

    Only what is installed is chosen, for MuJoCo fails to import where the one that MUJOCO_GL names is missing.
    """
    if "MUJOCO_GL" in os.environ or platform.system() != "Linux":
        return
    for name, libraries in (("egl", ("EGL", "OpenGL")), ("osmesa", ("OSMesa",))):
        if all(map(ctypes.util.find_library, libraries)):
            os.environ["MUJOCO_GL"] = name
            return


def picture(world: Scene, robot: Robot, title: str) -> bytes:
    """A PNG: the scene from behind the robot, and its depth image.

    Raises:
        UserError: if this machine has no OpenGL.
    """
    import io
    import math

    import jax
    import jax.numpy as jp
    from matplotlib.figure import Figure

    from loco_mjx.config import DepthConfig
    from loco_mjx.depth.render import render
    from loco_mjx.scene.mjcf import home_qpos

    view = _third_person(world, robot)  # first, for it is what may fail
    config = DepthConfig()
    home = jp.asarray(home_qpos(world, robot), jp.float32)
    depth = jax.jit(render, static_argnums=(2, 3))(world, home, robot.camera, config)
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    scenery, image = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    scenery.imshow(view)
    scenery.set_title(title)
    scenery.axis("off")
    # Pixels are wider than high: the image is square, the field of view is not.
    aspect = math.tan(math.radians(config.vertical_fov) / 2) / math.tan(math.radians(config.horizontal_fov) / 2)
    shown = image.imshow(depth, cmap="viridis_r", vmin=config.near, vmax=config.far, aspect=aspect)
    image.set_title("what the depth camera sees")
    image.axis("off")
    figure.colorbar(shown, ax=image, label="m", shrink=0.7)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    return buffer.getvalue()


def _third_person(world: Scene, robot: Robot) -> np.ndarray:
    """(rows, columns, 3) uint8 view from behind and above the robot, over what lies ahead of it."""
    import mujoco
    import numpy as np

    from loco_mjx.scene.mjcf import scene_spec
    from loco_mjx.show.gl import offscreen
    from loco_mjx.show.stage import goal_top, raise_to

    model = scene_spec(world, robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = data.qpos[:3] + np.array([2.0, 0.0, 0.2])
    camera.distance, camera.azimuth, camera.elevation = 5.0, 8.0, -20.0
    top = goal_top(world)
    if top is not None:
        camera.distance = 6.0  # both ends of a climb
        raise_to(camera, data.qpos[:3], top, PICTURE[1] / PICTURE[0])
    with offscreen(model, *PICTURE, "--png") as renderer:
        renderer.update_scene(data, camera)
        return renderer.render()
