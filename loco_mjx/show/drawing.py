"""Pictures from arrays: depth in colours, attention over depth, an inset in a view."""

from __future__ import annotations

import math

import numpy as np

from loco_mjx.config import DepthConfig

INSET = 0.32  # width of the inset, of the view's
MARGIN = 0.02  # between inset and border, of the view's width
STRONGEST = 0.75  # opacity of the most attended place


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


def overlay(depth: np.ndarray, attention: np.ndarray, config: DepthConfig) -> np.ndarray:
    """(H, W, 3) uint8: the depth image in grey under the attention, most opaque where it is strongest."""
    from matplotlib import colormaps

    spread = heat(attention, *depth.shape)
    part = spread / max(float(spread.max()), 1e-9)
    opacity = STRONGEST * part[..., None]
    under = depth_picture(depth, config, grey=True) / 255.0
    return _bytes((1.0 - opacity) * under + opacity * colormaps["hot"](0.25 + 0.55 * part)[..., :3])


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


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
