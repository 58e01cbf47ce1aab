"""Rays against a heightfield: vertical profiles of the terrain, a search in them, and a polish on the true surface.

Marching every ray over a 10 m view takes a hundred steps for each of 4,096 rays. Instead, the terrain is sampled along
LINES lines on the ground that fan out from beneath the camera. What matters of a line is its horizon: the steepest
slope from the camera to any sample so far, which only rises with distance. A ray hits where its line's horizon first
exceeds the ray's own slope, so a binary search finds the two samples between which it hits, and Newton's method on the
triangles there moves the hit from the nearest line to the ray itself.

Distances are measured along the camera's heading (its axis laid on the ground); a line or ray leaves the heading at an
angle given by its tangent, positive to the left.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
from flax import struct

from loco_mjx.config import DepthConfig
from loco_mjx.depth.primitives import Rays, larger, reciprocal, smaller
from loco_mjx.scene.types import Terrain

LINES = 96
PIECES = 2  # into which the interval of a ray's hit is divided
STEP = 0.05  # m, spacing of a line's samples for a level camera
NEAREST = (0.01, 0.025, 0.04, 0.06, 0.08)  # m, the first samples: a wall may stand right ahead
WIDEST = 3.0  # largest tangent of a line
SHORTEST = 0.05  # smallest component of a ray along the heading: for rays that look straight down, or back
NOTHING = -1e9  # slope to where there is no terrain


@struct.dataclass
class Ground:
    """A terrain as the camera sees it.

    Attributes:
        heights: (nx * ny,) heights above the camera, m.
        position: (2,) the point beneath the camera, in cells from vertex (0, 0).
        heading: (2,) the camera's heading, a unit vector in the world.
        shape: (nx, ny).
        cell: spacing of the grid, m.
    """

    heights: jax.Array
    position: jax.Array
    heading: jax.Array
    shape: tuple[int, int] = struct.field(pytree_node=False)
    cell: float = struct.field(pytree_node=False)

    def velocity(self, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Cells along x and y per metre along the heading, for what leaves it at an angle."""
        x, y = self.heading / self.cell
        return x - tangent * y, y + tangent * x


@struct.dataclass
class Slopes:
    """Rays as they run over the ground.

    Attributes:
        tangent: (pixels,) tangent of the angle to the heading.
        slope: (pixels,) rise per metre along the heading.
    """

    tangent: jax.Array
    slope: jax.Array


def from_camera(terrain: Terrain, origin: jax.Array, rotation: jax.Array) -> Ground:
    """The terrain as seen from a camera at ``origin`` (3,) whose ``rotation`` has the columns forward, left, up."""
    forward = rotation[:2, 0]
    length = jp.sqrt(jp.sum(forward * forward))
    heading = jp.where(length < 1e-6, jp.array([1.0, 0.0], jp.float32), forward / larger(length, 1e-6))
    position = (origin[:2] - jp.array(terrain.origin, jp.float32)) / terrain.cell
    nx, ny = terrain.heights.shape
    return Ground(terrain.heights.reshape(-1), position, heading, (nx, ny), terrain.cell)


def _take(values: jax.Array, index: jax.Array) -> jax.Array:
    """values[index], unchecked: the callers' indices are in bounds, for NaN too."""
    return values.at[index].get(mode="promise_in_bounds")


def _surface(ground: Ground, x: jax.Array, y: jax.Array) -> jax.Array:
    """Height of the triangles at points in cells; clamped to the grid.

    The same surface as :func:`loco_mjx.scene.surface.ground`.
    """
    nx, ny = ground.shape
    x, y = smaller(larger(x, 0.0), nx - 1.001), smaller(larger(y, 0.0), ny - 1.001)
    i, j = x.astype(jp.int32), y.astype(jp.int32)
    u, v = x - i, y - j
    lower = u >= v  # the triangle that holds vertex (i + 1, j); the other one holds (i, j + 1)
    vertex = i * ny + j
    start, end = _take(ground.heights, vertex), _take(ground.heights, vertex + ny + 1)
    third = _take(ground.heights, vertex + jp.where(lower, ny, 1))
    return start + larger(u, v) * (third - start) + smaller(u, v) * (end - third)


def _inside(ground: Ground, x: jax.Array, y: jax.Array) -> jax.Array:
    """Whether points in cells are on the grid."""
    return (x >= 0.0) & (x <= ground.shape[0] - 1.0) & (y >= 0.0) & (y <= ground.shape[1] - 1.0)


def _horizons(ground: Ground, height: jax.Array, tangents: jax.Array, distances: jax.Array) -> jax.Array:
    """(samples, lines) steepest slope from a camera at ``height`` to the terrain up to each distance, on each line."""
    along_x, along_y = ground.velocity(tangents)
    x, y = (ground.position[i] + distances[:, None] * along for i, along in enumerate((along_x, along_y)))
    slope = (_surface(ground, x, y) - height) / distances[:, None]
    slope = jp.where(_inside(ground, x, y), slope, NOTHING)

    def rise(horizon: jax.Array, slope: jax.Array) -> tuple[jax.Array, jax.Array]:
        horizon = larger(horizon, slope)
        return horizon, horizon

    # A loop, and not jp.cumulative_max: it also keeps the compiler from sampling the terrain anew for every sum.
    return jax.lax.scan(rise, slope[0], slope)[1]


def _first_above(horizons: jax.Array, line: jax.Array, slope: jax.Array) -> jax.Array:
    """The number of samples on each ray's line whose horizon is below the ray's slope: a binary search."""
    samples, lines = horizons.shape
    flat = horizons.reshape(-1)
    below = jp.zeros(line.shape, jp.int32)
    for bit in reversed(range(samples.bit_length())):
        more = below + (1 << bit)
        horizon = _take(flat, jp.minimum(more - 1, samples - 1) * lines + line)
        below = jp.where((more <= samples) & (horizon < slope), more, below)
    return below


def _refine(ground: Ground, height: jax.Array, rays: Slopes, near: jax.Array, far: jax.Array) -> jax.Array:
    """Where rays themselves first are below the surface between two distances: linear between PIECES + 1 points."""
    along_x, along_y = ground.velocity(rays.tangent)
    distances = [near + (far - near) * (piece / PIECES) for piece in range(PIECES + 1)]
    above = []
    for distance in distances:
        x, y = ground.position[0] + distance * along_x, ground.position[1] + distance * along_y
        above.append(_surface(ground, x, y) - height - rays.slope * distance)
    hit = far
    for piece in reversed(range(PIECES)):
        low, high = above[piece], above[piece + 1]
        share = smaller(larger(-low / larger(high - low, 1e-6), 0.0), 1.0)
        hit = jp.where(high >= 0.0, distances[piece] + (far - near) * (share / PIECES), hit)
    return hit


def _entry(ground: Ground, tangent: jax.Array) -> jax.Array:
    """Distance at which rays come onto the grid: no hit is nearer, though the sampled heights go on beyond the edge."""
    entry = jp.zeros_like(tangent)
    for speed, place, count in zip(ground.velocity(tangent), ground.position, ground.shape, strict=True):
        inverse = reciprocal(speed)
        entry = larger(smaller(-place * inverse, (count - 1.0 - place) * inverse), entry)
    return entry


def _distances(far: float) -> jax.Array:
    """Distances of a line's samples, m, for rays whose component along the heading is at most 1."""
    return jp.asarray(np.concatenate([NEAREST, np.arange(2 * STEP, far + STEP, STEP)]), jp.float32)


def cast(terrain: Terrain, origin: jax.Array, rotation: jax.Array, rays: Rays, config: DepthConfig) -> jax.Array:
    """Depth of a terrain; ``config.far`` where there is none.

    Args:
        terrain: the heightfield.
        origin: (3,) the camera, m.
        rotation: (3, 3) columns forward, left, up.
        rays: of all pixels, row by row.
        config: ``far`` and the image's size are read.

    Returns:
        (pixels,) planar depth, m; within centimetres except along silhouettes. A crest that is one cell wide may be
        missed where it falls between samples or, farther than about 5 m, between lines.
    """
    ground = from_camera(terrain, origin, rotation)
    along = larger(rays.x * ground.heading[0] + rays.y * ground.heading[1], SHORTEST)
    across = rays.y * ground.heading[0] - rays.x * ground.heading[1]
    depth_per_distance = 1.0 / along
    slopes = Slopes(across * depth_per_distance, rays.z * depth_per_distance)

    # Both are extreme at corners of the image.
    corners = np.array([0, config.width - 1, -config.width, -1])
    widest = smaller(jp.max(jp.abs(slopes.tangent[corners])), WIDEST)
    distances = _distances(config.far) * jp.max(along[corners])
    tangents = widest * jp.asarray(np.linspace(-1.0, 1.0, LINES, dtype=np.float32))
    horizons = _horizons(ground, origin[2], tangents, distances)

    line = jp.clip(((slopes.tangent / widest + 1.0) * (0.5 * (LINES - 1)) + 0.5).astype(jp.int32), 0, LINES - 1)
    below = _first_above(horizons, line, slopes.slope)
    near = jp.where(below > 0, _take(distances, jp.maximum(below - 1, 0)), 0.0)
    far = _take(distances, jp.minimum(below, distances.size - 1))
    margin = 0.5 * (far - near)
    distance = _refine(ground, origin[2], slopes, larger(near - margin, 0.0), far + margin)
    distance = larger(distance, _entry(ground, slopes.tangent))
    depth = distance * depth_per_distance
    return jp.where((below < distances.size) & (depth < config.far), depth, config.far)
