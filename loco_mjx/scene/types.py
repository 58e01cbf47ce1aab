"""A world as a small pytree of arrays: what physics, depth, rewards and the MJCF writer all read.

World frame: x forward, y left, z up, metres. Every array describes one environment; batches come from ``jax.vmap``.
"""

from __future__ import annotations

import jax
import jax.numpy as jp
from flax import struct

# Kinds of boxes. Obstacles and walls collide, and count as collisions; steps are ground one walks on.
OBSTACLE, WALL, STEP = 0, 1, 2
# An obstacle's or wall's collision box is larger than what the camera sees, per side in x and y (m).
COLLISION_MARGIN = 0.05


@struct.dataclass
class Boxes:
    """N boxes, turned about z only.

    Attributes:
        center: (N, 3) centres, m.
        half: (N, 3) visual half extents, m.
        yaw: (N,) rotation about z, rad.
        velocity: (N, 2) velocity in x and y, m/s; zero for what stands still.
        kind: (N,) int32, OBSTACLE, WALL or STEP.
    """

    center: jax.Array
    half: jax.Array
    yaw: jax.Array
    velocity: jax.Array
    kind: jax.Array

    @property
    def count(self) -> int:
        """How many boxes there are (static)."""
        return self.center.shape[-2]

    @property
    def collision_half(self) -> jax.Array:
        """(N, 3) half extents for contact: obstacles and walls are 0.05 m larger per side in x and y."""
        margin = jp.where(self.kind == STEP, 0.0, COLLISION_MARGIN)
        return self.half + margin[..., None] * jp.array([1.0, 1.0, 0.0])


@struct.dataclass
class Spheres:
    """S spheres to collect: visible until collected, never in contact.

    Attributes:
        center: (S, 3) centres, m.
        radius: (S,) radii, m.
        collected: (S,) bool.
        reward: (S,) bool, whether collecting it is rewarded (the goal's marker is a sphere that is not).
    """

    center: jax.Array
    radius: jax.Array
    collected: jax.Array
    reward: jax.Array

    @property
    def count(self) -> int:
        """How many spheres there are (static)."""
        return self.center.shape[-2]


@struct.dataclass
class Cylinders:
    """C upright cylinders (trees): obstacles.

    Attributes:
        center: (C, 3) centres, m.
        radius: (C,) visual radii, m; contact adds COLLISION_MARGIN.
        half_height: (C,) half heights, m.
    """

    center: jax.Array
    radius: jax.Array
    half_height: jax.Array

    @property
    def count(self) -> int:
        """How many cylinders there are (static)."""
        return self.center.shape[-2]


@struct.dataclass
class Terrain:
    """A heightfield over a regular grid; outside the grid its border heights go on for contact, and nothing is seen.

    Each cell is split into two triangles as C MuJoCo splits it.

    Attributes:
        heights: (nx, ny) surface height at vertex (i, j), m; vertex (i, j) is at origin + cell · (i, j).
        origin: (x, y) of vertex (0, 0), m (static).
        cell: spacing of the grid, m (static).
    """

    heights: jax.Array
    origin: tuple[float, float] = struct.field(pytree_node=False)
    cell: float = struct.field(pytree_node=False)


@struct.dataclass
class Scene:
    """One environment's world.

    Attributes:
        boxes: obstacles, walls and steps; N may be 0.
        spheres: spheres to collect and the goal's marker; S may be 0.
        cylinders: trees; C may be 0.
        terrain: the ground's heightfield, or None for the plane z = 0.
        goal: (3,) the point that "forward" means in tasks with a goal; zeros elsewhere.
    """

    boxes: Boxes
    spheres: Spheres
    cylinders: Cylinders
    terrain: Terrain | None
    goal: jax.Array
