"""Pictures from arrays: depth in colours, attention over depth, an inset in a view."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from loco_mjx.config import DepthConfig

INSET = 0.32  # width of the inset, of the view's
MARGIN = 0.02  # between inset and border, of the view's width
STRONGEST = 0.75  # opacity of the most attended place
TOP = 4.0  # times uniform attention, the end of its scale; a policy that has learnt nothing stays near 1
LABEL = "attention ÷ uniform"


def aspect(config: DepthConfig) -> float:
    """Width over height of the depth camera's view; its pixels are not square."""
    return math.tan(math.radians(config.horizontal_fov) / 2) / math.tan(math.radians(config.vertical_fov) / 2)


def depth_picture(depth: np.ndarray, config: DepthConfig, grey: bool = False) -> np.ndarray:
    """(H, W, 3) uint8 of an (H, W) depth image in m: near is bright; the clips are the ends of the scale."""
    from matplotlib import colormaps

    part = np.clip((depth - config.near) / (config.far - config.near), 0.0, 1.0)
    return _bytes(colormaps["gray_r" if grey else "viridis_r"](np.sqrt(part))[..., :3])


def heat(attention: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(rows, columns) attention spread over the image, bilinearly between the tokens' places.

    Args:
        attention: (N·N,) row by row from the image's top left, as networks/encoders.py orders visual tokens.
        rows: of the image.
        columns: of the image.
    """
    side = math.isqrt(attention.size)
    grid = np.asarray(attention, np.float64).reshape(side, side)
    return _spread(side, rows).T @ grid @ _spread(side, columns)


def _spread(count: int, size: int) -> np.ndarray:
    """(count, size) weights of each of `count` cells, laid evenly along `size` pixels, on each pixel."""
    place = np.clip((np.arange(size) + 0.5) * count / size - 0.5, 0.0, count - 1.0)
    return np.maximum(0.0, 1.0 - np.abs(place[None] - np.arange(count)[:, None]))


def times_uniform(attention: np.ndarray) -> np.ndarray:
    """Attention as a multiple of what every token gets that all share alike, the state token itself among them.

    Args:
        attention: (N·N,) of the state token to the visual tokens; what remains to 1 goes to itself.
    """
    return np.asarray(attention, np.float64) * (np.size(attention) + 1)


def overlay(depth: np.ndarray, attention: np.ndarray, config: DepthConfig) -> np.ndarray:
    """(H, W, 3) uint8: the depth image in grey under the attention, on one scale for every frame and policy.

    Uniform attention and less is clear; :data:`TOP` times as much and more is strongest.
    """
    spread = heat(times_uniform(attention), *depth.shape)
    return _bytes(attended(spread, depth_picture(depth, config, grey=True) / 255.0))


def attended(times: np.ndarray, under: np.ndarray) -> np.ndarray:
    """What shows through, under the colour of attention.

    Args:
        times: (..., n) attention, in multiples of uniform.
        under: (..., n, 3) or (3,) colours, 0 … 1.
    """
    from matplotlib import colormaps

    part = np.clip((times - 1.0) / (TOP - 1.0), 0.0, 1.0)
    opacity = STRONGEST * part[..., None]
    return (1.0 - opacity) * under + opacity * colormaps["hot"](0.25 + 0.55 * part)[..., :3]


@cache
def scale(columns: int) -> np.ndarray:
    """(rows, columns, 3) uint8 bar of attention's colours over a middle grey, with its label beneath."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    letters = max(columns / 13, 7.0)  # pixels high
    bar, rows = round(0.6 * letters), round(2.1 * letters)
    canvas = FigureCanvasAgg(Figure(figsize=(columns / 100, (rows - bar) / 100), dpi=100))
    for place, side, text in ((0.01, "left", "≤1"), (0.5, "center", LABEL), (0.99, "right", f"≥{TOP:g}")):
        canvas.figure.text(place, 0.5, text, ha=side, va="center", fontsize=0.65 * letters)
    canvas.draw()
    words = np.asarray(canvas.buffer_rgba())[..., :3]
    colours = _bytes(attended(np.linspace(1.0, TOP, columns), np.full(3, 0.5)))
    return np.concatenate([np.broadcast_to(colours, (bar, columns, 3)), words])


def enlarge(image: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """(rows, columns, 3) uint8, by nearest neighbours."""
    i = np.arange(rows) * image.shape[0] // rows
    j = np.arange(columns) * image.shape[1] // columns
    return image[i[:, None], j[None]]


def inset_box(view: tuple[int, int], ratio: float) -> tuple[slice, slice]:
    """Rows and columns of the inset in a view of (rows, columns): at the upper left, where the robot is not.

    Args:
        view: size of the view.
        ratio: width over height of the inset.
    """
    width = round(INSET * view[1])
    height = min(round(width / ratio), view[0])
    margin = min(round(MARGIN * view[1]), view[0] - height)
    return slice(margin, margin + height), slice(margin, margin + width)


def with_inset(view: np.ndarray, image: np.ndarray, ratio: float) -> np.ndarray:
    """A copy of a view with an image at its upper left, in a white frame."""
    rows, columns = inset_box(view.shape[:2], ratio)
    out = view.copy()
    out[max(rows.start - 1, 0) : rows.stop + 1, max(columns.start - 1, 0) : columns.stop + 1] = 255
    out[rows, columns] = enlarge(image, rows.stop - rows.start, columns.stop - columns.start)
    return out


def with_scale(view: np.ndarray, ratio: float) -> np.ndarray:
    """A copy of a view with an inset, with the scale of attention below it."""
    rows, columns = inset_box(view.shape[:2], ratio)
    bar = scale(columns.stop - columns.start)[: view.shape[0] - rows.stop]
    out = view.copy()
    out[rows.stop + 1 : rows.stop + 1 + len(bar), columns] = bar[: len(out) - rows.stop - 1]
    return out


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
