"""A rollout as a video, and as a figure of a few of its moments."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from loco_mjx.config import DepthConfig
from loco_mjx.errors import UserError
from loco_mjx.robots import Robot
from loco_mjx.show import drawing, gl
from loco_mjx.show.rollout import Moment, Rollout
from loco_mjx.show.stage import Follower, Stage

ATTENTION = "attention"  # the row of a figure that has a scale
VIDEOS, FIGURES = (".mp4", ".gif"), (".png", ".svg")
# One palette for the whole film, and no dither: what stands still costs nothing.
GIF = ["-filter_complex", "split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none:diff_mode=rectangle"]
MP4 = ["-crf", "23", "-movflags", "+faststart"]


class Painter:
    """Draws moments: the robot from behind, and its depth image."""

    def __init__(self, robot: Robot, rows: int, columns: int, depth: DepthConfig, what: str) -> None:
        """Who is seen, size of the view, the camera's configuration, and the option that asked, for complaints."""
        self._robot = robot
        self.rows, self.columns, self.depth, self.what = rows, columns, depth, what
        self._follower, self._episode = Follower(ratio=columns / rows), -1
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def view(self, moment: Moment) -> np.ndarray:
        """(rows, columns, 3) uint8 from behind and above the robot."""
        if moment.episode != self._episode:
            self._open.close()
            self._stage, self._episode = Stage(moment, self._robot), moment.episode
            self._renderer = self._open.enter_context(
                gl.offscreen(self._stage.model, self.rows, self.columns, self.what)
            )
        self._stage.pose(moment)
        self._renderer.update_scene(self._stage.data, self._follower.follow(moment))
        return self._renderer.render()

    def eye(self, moment: Moment, attention: bool) -> np.ndarray | None:
        """(H, W, 3) uint8 of the depth image, under the attention if asked for; None without a camera."""
        if moment.depth is None:
            return None
        if attention and moment.attention is not None:
            return drawing.overlay(moment.depth, moment.attention, self.depth)
        return drawing.depth_picture(moment.depth, self.depth)

    def frame(self, moment: Moment, attention: bool) -> np.ndarray:
        """The view with the depth image as its inset."""
        view, eye = self.view(moment), self.eye(moment, attention)
        if eye is None:
            return view
        shown = drawing.with_inset(view, eye, drawing.aspect(self.depth))
        scaled = attention and moment.attention is not None
        return drawing.with_scale(shown, drawing.aspect(self.depth)) if scaled else shown


def moments(rollout: Rollout, seed: int, count: int) -> Iterator[Moment]:
    """`count` moments from a seed's first one on, episode after episode."""
    for index in range(count):
        yield rollout.step() if index else rollout.reset(seed)


def check_attention(rollout: Rollout) -> None:
    """Refuses to draw attention where there is none.

    Raises:
        UserError: saying which agents have it.
    """
    if not rollout.agent.attends:
        agent = rollout.agent.policy.config.policy if rollout.agent.policy is not None else rollout.agent.kind
        raise UserError(
            f"'{agent}' has no attention from a state token to visual tokens; --attention needs a loco-transformer "
            "with network.layers of 1 or more"
        )


def check_output(path: Path, suffixes: tuple[str, ...], overwrite: bool) -> None:
    """Refuses a file that cannot be written, before anything is computed.

    Raises:
        UserError: naming what is wrong with it.
    """
    if path.suffix.lower() not in suffixes:
        raise UserError(f"'{path}' ends in '{path.suffix}'; accepted: {', '.join(suffixes)}")
    if path.is_dir():
        raise UserError(f"'{path}' is a directory; accepted: the name of a file")
    if not path.parent.is_dir():
        raise UserError(f"there is no directory '{path.parent}' to write '{path.name}' into")
    if path.exists() and not overwrite:
        raise UserError(f"'{path}' exists; choose another name, or --overwrite it")


@contextlib.contextmanager
def writer(path: Path, rows: int, columns: int, fps: float) -> Iterator[Callable[[np.ndarray], Any]]:
    """Gives a function that adds a (rows, columns, 3) frame; the file appears whole, when all are written."""
    partial = path.with_name(f".partial-{path.name}")
    command = _command(partial, rows, columns, fps, gif=path.suffix.lower() == ".gif")
    with tempfile.TemporaryFile() as log:
        # A group of its own keeps Ctrl-C from it; a `preexec_fn` would fork, which is unsafe beside JAX's threads.
        film = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=log, process_group=0)
        pipe = cast(IO[bytes], film.stdin)
        try:
            yield lambda frame: pipe.write(frame.tobytes())
            pipe.close()
            if film.wait():
                raise OSError(f"ffmpeg ended with {film.returncode}")
            partial.replace(path)
        except OSError as error:
            film.kill()
            film.wait()
            raise UserError(f"cannot write '{path}': {_complaint(log) or error.strerror or error}") from error
        finally:
            film.kill()
            with contextlib.suppress(OSError):
                pipe.close()
            film.wait()
            partial.unlink(missing_ok=True)


def _command(path: Path, rows: int, columns: int, fps: float, gif: bool) -> list[str]:
    """The command of ffmpeg for raw frames on its standard input."""
    import imageio_ffmpeg

    frames = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{columns}x{rows}", "-r", str(fps), "-i", "-"]
    codec = ["-c:v", "gif", *GIF] if gif else ["-c:v", "libx264", "-pix_fmt", "yuv420p", *MP4]
    return [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", *frames, "-an", *codec, str(path)]


def _complaint(log: IO[bytes]) -> str:
    """What ffmpeg complained of first; the rest follows from it."""
    log.seek(0)
    lines = log.read().decode(errors="replace").split("\n")
    return next((line.strip() for line in lines if line.strip()), "")


def _add_scale(figure: Any, axes: Any) -> None:
    """The bar of attention's colours at the end of a row."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colours = ListedColormap(drawing.attended(np.linspace(1.0, drawing.TOP, 256), np.full(3, 0.5)))
    bar = figure.colorbar(ScalarMappable(Normalize(1.0, drawing.TOP), colours), ax=axes, extend="both")
    bar.set_label(drawing.LABEL, fontsize=8)
    bar.ax.tick_params(labelsize=7)


def strip(rows: list[tuple[str, list[np.ndarray]]], times: list[float], ratio: float, path: Path) -> None:
    """Writes a figure: a column per moment, a row per kind of picture.

    Args:
        rows: name and pictures of each row.
        times: of the moments, s.
        ratio: width over height of what is not the first row's.
        path: file, .png or .svg.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.6 * len(times), 1.75 * len(rows)), layout="constrained")
    axes: Any = figure.subplots(len(rows), len(times), squeeze=False)
    for place, (name, pictures) in enumerate(rows):
        for axis, picture, time in zip(axes[place], pictures, times, strict=True):
            shown = picture.shape[0] / picture.shape[1] * ratio
            axis.imshow(picture, aspect="equal" if place == 0 else 1 / shown)
            axis.set_xticks([])
            axis.set_yticks([])
            if place == 0:
                axis.set_title(f"{time:.1f} s", fontsize=9)
        axes[place][0].set_ylabel(name, fontsize=9)
        if name == ATTENTION:
            _add_scale(figure, axes[place])
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise UserError(f"cannot write '{path}': {error.strerror or error}") from error
