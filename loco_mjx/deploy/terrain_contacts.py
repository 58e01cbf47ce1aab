"""C MuJoCo's contacts of spheres with a heightfield, each with the plane of the triangle beneath the sphere's centre.

C makes a contact with every prism that a sphere is in. Where the sphere is pressed in so deep that its centre is below
the surface, as a foot is that lands hard on the default softness, the nearest face of a neighbour's prism is its
vertical side: C then pushes sideways, where there is nothing but ground. Robots are caught by it within a second. The
planes are those of training (docs/architecture.md, Physics).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from loco_mjx.deploy.terrain_rays import heightfield

AGAIN = ("mj_makeConstraint", "mj_island", "mj_projectConstraint", "mj_fwdVelocity")  # what contacts go into


class TerrainContacts:
    """Steps a model, with planes for the spheres that touch its heightfield."""

    def __init__(self, model: Any, prisms: bool = False) -> None:
        """Takes the model's first heightfield that is level and fixed to the world; there may be none.

        Args:
            model: mujoco.MjModel.
            prisms: change nothing.
        """
        import mujoco

        self._mujoco, self._model = mujoco, model
        level = [
            geom
            for geom in range(model.ngeom)
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD
            and model.geom_bodyid[geom] == 0
            and np.allclose(model.geom_quat[geom], [1.0, 0.0, 0.0, 0.0])
        ]
        self._ground = level[0] if level and not prisms else None

    def step(self, data: Any) -> None:
        """`mj_step` with these contacts."""
        if self._ground is None:
            self._mujoco.mj_step(self._model, data)
            return
        self._mujoco.mj_step1(self._model, data)
        if self.flatten(data):
            for stage in AGAIN:
                getattr(self._mujoco, stage)(self._model, data)
        self._mujoco.mj_step2(self._model, data)

    def flatten(self, data: Any) -> bool:
        """Gives every sphere that touches the heightfield its one contact; whether there are any."""
        model, contact = self._model, data.contact
        if self._ground is None or data.ncon == 0:
            return False
        first, second = contact.geom[:, 0], contact.geom[:, 1]
        other = np.where(first == self._ground, second, first)
        touching = ((first == self._ground) | (second == self._ground)) & (
            model.geom_type[other] == self._mujoco.mjtGeom.mjGEOM_SPHERE
        )
        if not touching.any():
            return False
        which = np.flatnonzero(touching)
        spheres, kept = np.unique(other[which], return_index=True)
        contact.exclude[which] = 1  # of no constraint
        center, radius = data.geom_xpos[spheres], model.geom_size[spheres, 0]
        height, normal = plane(model, self._ground, center)
        gap = (center[:, 2] - height) * normal[:, 2] - radius
        for k in np.flatnonzero(gap < 0.0):
            one = contact[int(which[kept[k]])]
            one.exclude, one.dist = 0, gap[k]
            one.pos[:] = center[k] - normal[k] * (radius[k] + 0.5 * gap[k])
            sign = 1.0 if first[which[kept[k]]] == self._ground else -1.0  # from the first geom to the second
            one.frame[:] = _frame(sign * normal[k])
        return True


def plane(model: Any, geom: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height and upward normal of a level heightfield's triangles under points, as in loco_mjx/scene/surface.py.

    Args:
        model: mujoco.MjModel.
        geom: the heightfield's.
        points: (N, 3) m, world.

    Returns:
        (N,) m and (N, 3). Outside the grid the border's heights go on, level across it.
    """
    relative, (half_x, half_y, top, _) = heightfield(model, geom)
    heights, (rows, columns) = relative * top, relative.shape
    u, i, cell_x, inside_x = _locate(points[:, 0] - model.geom_pos[geom, 0], half_x, columns)
    v, j, cell_y, inside_y = _locate(points[:, 1] - model.geom_pos[geom, 1], half_y, rows)
    near, far = heights[j, i], heights[j + 1, i + 1]
    lower = u >= v
    third = np.where(lower, heights[j, i + 1], heights[j + 1, i])
    rise_x, rise_y = np.where(lower, third - near, far - third), np.where(lower, far - third, third - near)
    slope = np.stack([-rise_x / cell_x * inside_x, -rise_y / cell_y * inside_y, np.ones(len(u))], axis=1)
    height = near + rise_x * u + rise_y * v + model.geom_pos[geom, 2]
    return height, slope / np.linalg.norm(slope, axis=1, keepdims=True)


def _locate(place: np.ndarray, half: float, count: int) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Position in its cell (0…1), the cell's index, its size, and whether it is in the grid, along one axis."""
    cell = 2.0 * half / (count - 1)
    position = (place + half) / cell
    clamped = np.clip(position, 0.0, count - 1.0)
    index = np.clip(np.floor(clamped).astype(int), 0, count - 2)
    return clamped - index, index, cell, (position >= 0.0) & (position <= count - 1.0)


def _frame(normal: np.ndarray) -> np.ndarray:
    """(9,) a contact's axes, the normal first; the other two as MuJoCo chooses them."""
    side = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.5 else np.array([0.0, 0.0, 1.0])
    side = side - normal * (normal @ side)
    side /= np.linalg.norm(side)
    return np.concatenate([normal, side, np.cross(normal, side)])
