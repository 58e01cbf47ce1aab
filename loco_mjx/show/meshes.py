"""The geoms of a compiled MuJoCo model as triangles: what a browser draws."""

from __future__ import annotations

from typing import cast

import mujoco
import numpy as np
import trimesh

TILE = 1.0  # m, side of a square of the floor's checker
FLOOR_TILES = 40  # across the square that stands for an endless plane, where the robot is
FLOOR_COLOURS = ((140, 144, 150), (92, 97, 104))
SEEN_GROUPS = (1, 2)  # of geoms: the robot's looks, the scene's (scene/mjcf.py)
_GEOM = mujoco.mjtGeom


def colour(model: mujoco.MjModel, geom: int) -> tuple[int, int, int]:
    """The colour of a geom, 0 … 255: its material's, where it has one."""
    material = model.geom_matid[geom]
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue = (round(255 * float(part)) for part in rgba[:3])
    return red, green, blue


def mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """A geom in its body's frame, m.

    Raises:
        ValueError: for a type of geom that our scenes do not have.
    """
    shape = _shape(model, geom)
    pose = np.eye(4)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), model.geom_pos[geom]
    shape.apply_transform(pose)
    return shape


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _GEOM.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    if kind == _GEOM.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2 * size[1], sections=20)
    if kind == _GEOM.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(2 * size[1], size[0], count=(12, 12))
    if kind == _GEOM.mjGEOM_HFIELD:
        return _heightfield(model, model.geom_dataid[geom])
    raise ValueError(f"no triangles for geoms of type {kind}")


def floor() -> list[tuple[str, trimesh.Trimesh, tuple[int, int, int]]]:
    """A checkered square at z = 0 about the origin, name, triangles and colour of its light and its dark tiles.

    It stands for an endless plane when it goes along with the robot by :func:`floor_place`.
    """
    index = np.arange(FLOOR_TILES) - FLOOR_TILES // 2
    row, column = (side.ravel() for side in np.meshgrid(index, index))
    pieces = []
    for parity, paint in enumerate(FLOOR_COLOURS):
        mine = (row + column) % 2 == parity
        corner = np.stack([row[mine], column[mine], np.zeros(mine.sum())], axis=1)
        square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        vertices = TILE * (corner[:, None] + square).reshape(-1, 3)
        first = 4 * np.arange(len(corner))[:, None, None]
        faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        pieces.append((f"tiles{parity}", trimesh.Trimesh(vertices, faces, process=False), paint))
    return pieces


def floor_place(robot: np.ndarray) -> np.ndarray:
    """(3,) where the floor lies for a robot at (3,) m: near it, and moved by what the checker repeats after."""
    place = 2 * TILE * np.round(np.asarray(robot, np.float64) / (2 * TILE))
    return place * np.array([1.0, 1.0, 0.0])


def has_floor(model: mujoco.MjModel) -> bool:
    """Whether a plane is to be seen."""
    return any(
        model.geom_type[geom] == _GEOM.mjGEOM_PLANE and model.geom_group[geom] in SEEN_GROUPS
        for geom in range(model.ngeom)
    )


def _heightfield(model: mujoco.MjModel, index: int) -> trimesh.Trimesh:
    """Two triangles a cell."""
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    start = model.hfield_adr[index]
    half_x, half_y, span, _ = model.hfield_size[index]
    heights = model.hfield_data[start : start + rows * columns] * span
    x = np.tile(np.linspace(-half_x, half_x, columns), rows)
    y: np.ndarray = np.repeat(np.linspace(-half_y, half_y, rows), columns)
    vertices = np.stack([x, y, heights], axis=1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    return trimesh.Trimesh(vertices, np.concatenate([lower, upper]), process=False)


def by_body(
    model: mujoco.MjModel, apart: set[int]
) -> dict[int, list[tuple[str, trimesh.Trimesh, tuple[int, int, int]]]]:
    """What is seen of each body but planes: name, triangles and colour, one piece per colour.

    Args:
        model: compiled from a scene.
        apart: geoms to keep as pieces of their own, named ``geom<id>``.
    """
    pieces: dict[int, dict[tuple[str, tuple[int, int, int]], list[trimesh.Trimesh]]] = {}
    for geom in range(model.ngeom):
        if geom not in apart and model.geom_group[geom] not in SEEN_GROUPS:
            continue
        if model.geom_type[geom] == _GEOM.mjGEOM_PLANE:  # endless: see `floor`
            continue
        paint = colour(model, geom)
        name = f"geom{geom}" if geom in apart else "colour{:02x}{:02x}{:02x}".format(*paint)
        pieces.setdefault(int(model.geom_bodyid[geom]), {}).setdefault((name, paint), []).append(mesh(model, geom))
    return {
        body: [
            (name, cast(trimesh.Trimesh, trimesh.util.concatenate(parts)), paint)
            for (name, paint), parts in named.items()
        ]
        for body, named in pieces.items()
    }
