"""Runs a rollout once and writes what was asked for of it."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loco_mjx.show import drawing, gl, video
from loco_mjx.show.rollout import Rollout


@dataclass(frozen=True)
class Recording:
    """What came of it.

    Attributes:
        frames: written to the video.
        ends: (step, distance in m) of each episode that ended on the way.
        distance: m, of the last episode so far.
    """

    frames: int
    ends: list[tuple[int, float]]
    distance: float


def record(
    rollout: Rollout,
    seed: int,
    seconds: float,
    film: Path | None = None,
    figure: Path | None = None,
    attention: bool = False,
    width: int = 640,
    every: int = 1,
    columns: int = 5,
) -> Recording:
    """Runs an agent, and films it.

    Args:
        rollout: agent and environment.
        seed: of the scene.
        seconds: how long, of simulated time.
        film: file for the video, .mp4 or .gif, with a frame for every so many control steps.
        figure: file for a strip of `columns` moments, .png or .svg.
        attention: draw it over the depth image.
        width: of the view, pixels; it is 16:9.
        every: control steps per frame of the video.
        columns: of the figure.

    Raises:
        UserError: if there is no OpenGL, no attention to draw, or no way to write.
    """
    if attention:
        video.check_attention(rollout)
    gl.check("--video" if film is not None else "--figure")
    rate = round(1 / rollout.env.dt)
    count = max(round(seconds * rate), 1)
    shape = (2 * round(width * 9 / 32), 2 * (width // 2))
    depth = rollout.config.observation.depth
    chosen = set(np.linspace(0, count - 1, columns + 1).round().astype(int)[1:].tolist())
    pictures: list[tuple[float, np.ndarray, list[np.ndarray]]] = []
    frames, ends, distance = 0, [], 0.0
    with contextlib.ExitStack() as stack:
        what = "--video" if film is not None else "--figure"
        painter = stack.enter_context(video.Painter(rollout.env.robot, *shape, depth, what))
        add = stack.enter_context(video.writer(film, *shape, rate / every)) if film is not None else None
        for index, moment in enumerate(video.moments(rollout, seed, count)):
            distance = moment.distance
            ends += [(moment.step, distance)] if moment.done else []
            if add is not None and index % every == 0:
                add(painter.frame(moment, attention))
                frames += 1
            if figure is not None and index in chosen:
                eyes = [painter.eye(moment, kind) for kind in ((False, True) if attention else (False,))]
                shown = [eye for eye in eyes if eye is not None]
                pictures.append((index * rollout.env.dt, painter.view(moment), shown))
    if figure is not None:
        names = ("depth", video.ATTENTION)[: len(pictures[0][2])]
        rows = [("view", [view for _, view, _ in pictures])]
        rows += [(name, [eyes[place] for _, _, eyes in pictures]) for place, name in enumerate(names)]
        video.strip(rows, [time for time, _, _ in pictures], drawing.aspect(depth), figure)
    return Recording(frames, ends, distance)
