"""A heightfield's surface as a mesh, for rays: C MuJoCo walks a mesh's tree, but steps a heightfield cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np


class TerrainRays:
    """The ground's heightfields of a model, in a model of their own that has nothing else.

    An image of `mountain` takes many times as long by C's rays on its heightfield as by those on the mesh of the same
    triangles, which end at the same distances.
    """

    def __init__(self, model: Any, seen: int, left: int) -> None:
        """Takes over the heightfields that are fixed to the world.

        Args:
            model: mujoco.MjModel; its heightfields change their group.
            seen: group of what rays shall hit.
            left: group that heightfields have afterwards, which rays leave out and viewers still show.
        """
        import mujoco

        self._mujoco, spec = mujoco, mujoco.MjSpec()
        for geom in range(model.ngeom):
            fixed = model.geom_bodyid[geom] == 0 and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD
            if fixed and model.geom_group[geom] == seen:
                self._add(spec, model, geom, seen)
                model.geom_group[geom] = left
        self._model = spec.compile() if spec.geoms else None
        if self._model is not None:
            self._data = mujoco.MjData(self._model)
            mujoco.mj_forward(self._model, self._data)

    def _add(self, spec: Any, model: Any, geom: int, group: int) -> None:
        mujoco = self._mujoco
        vertices, faces = surface(*heightfield(model, geom))
        mesh = spec.add_mesh(name=f"ground_{geom}", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel().astype(np.int32)
        shown = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, group=group)
        shown.pos, shown.quat = model.geom_pos[geom], model.geom_quat[geom]

    def nearest(
        self, origin: np.ndarray, unit: np.ndarray, groups: np.ndarray, hit: np.ndarray, far: np.ndarray
    ) -> None:
        """Puts what is nearer than the hits so far into them.

        Args:
            origin: (3,) m, of all rays.
            unit: (N · 3,) their directions.
            groups: (mjNGROUP,) what is hit.
            hit: (N,) int32, negative where nothing was hit; changed.
            far: (N,) distances, m; changed.
        """
        if self._model is None:
            return
        from loco_mjx.depth import c_mujoco

        also, distance = c_mujoco.nearest(self._model, self._data, origin, unit, groups)
        nearer = (also >= 0) & ((hit < 0) | (distance < far))
        hit[nearer], far[nearer] = also[nearer], distance[nearer]


def heightfield(model: Any, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """A geom's heights (R, C) in 0..1, rows along y; and its size (4,), m, as in :func:`surface`."""
    field = model.geom_dataid[geom]
    start, rows, columns = model.hfield_adr[field], int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    return model.hfield_data[start : start + rows * columns].reshape(rows, columns), model.hfield_size[field]


def surface(heights: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of a heightfield and of its sides, as MuJoCo has them.

    Args:
        heights: (R, C) in 0..1, rows along y.
        size: (4,) m: half width x, half width y, height of a 1, depth of the base.

    Returns:
        vertices (R · C + 2 (R + C), 3), m, in the field's frame; faces (F, 3) of their indices.
    """
    rows, columns = heights.shape
    x, y = np.meshgrid(np.linspace(-size[0], size[0], columns), np.linspace(-size[1], size[1], rows))
    top = np.stack([x, y, heights * size[2]], axis=-1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    # round the edge, and the same points at the bottom
    edge = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    below = np.arange(len(edge)) + len(top)
    bottom = top[edge] * [1.0, 1.0, 0.0] - [0.0, 0.0, size[3]]
    after, after_below = np.roll(edge, -1), np.roll(below, -1)
    triangles = ((a, b, d), (a, d, c), (edge, after, below), (after, after_below, below))
    return np.concatenate([top, bottom]), np.concatenate([np.stack(corner, axis=1) for corner in triangles])
