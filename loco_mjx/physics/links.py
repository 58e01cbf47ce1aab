"""A robot's masses and inertias, link by link, as MuJoCo has compiled them."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import mujoco
import numpy as np

from loco_mjx.physics.block_matrix import BASE, JOINTS, LEGS
from loco_mjx.physics.spatial import Inertia
from loco_mjx.robots import LEGS as LEG_NAMES
from loco_mjx.robots import PARTS


@dataclass(frozen=True, eq=False)
class Links:
    """Inertias of a robot's links about their joints, in the robot's pose of zeros; index 0 trunk, then a leg's parts.

    Attributes:
        mass: of the trunk (), then of hips, thighs and calves, each (4,) over legs, kg.
        moment: mass times centre of mass, likewise with x, y, z in front: (3,), then (3, 4), kg m.
        offset: of masses that sit off the joint, likewise with xx, yy, zz, yz, xz, xy in front, kg m²; scaled by mass.
        own: of bodies about their own centres, likewise; scaled by inertia.
        armature: what the joints' own inertias add to the matrix: (6, 6, 1) and (3, 3, 4, 1), kg and kg m².
    """

    mass: tuple[np.ndarray, ...]
    moment: tuple[np.ndarray, ...]
    offset: tuple[np.ndarray, ...]
    own: tuple[np.ndarray, ...]
    armature: tuple[np.ndarray, np.ndarray]


def _six(matrix: np.ndarray) -> np.ndarray:
    """xx, yy, zz, yz, xz, xy."""
    return matrix[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]


def links(model: mujoco.MjModel) -> Links:
    """The links of a robot that MuJoCo has compiled; bodies that no joint moves belong to the one that carries them."""
    data = mujoco.MjData(model)
    data.qpos[3] = 1.0
    mujoco.mj_kinematics(model, data)
    names = [f"{leg}_{part}" for part in PARTS for leg in LEG_NAMES]
    carriers = [int(model.jnt_bodyid[0]), *(model.body(name).id for name in names)]
    found = np.zeros((len(carriers), 1 + 3 + 6 + 6))
    for body in range(1, model.nbody):
        link = body
        while link not in carriers:
            link = model.body_parentid[link]
        mass, away = model.body_mass[body], data.xipos[body] - data.xpos[link]
        turn = data.ximat[body].reshape(3, 3)
        offset = mass * (away @ away * np.eye(3) - np.outer(away, away))
        own = turn @ np.diag(model.body_inertia[body]) @ turn.T
        found[carriers.index(link)] += np.concatenate([[mass], mass * away, _six(offset), _six(own)])
    trunk, legs = found[0], np.moveaxis(found[1:].reshape(JOINTS, LEGS, -1), 2, 1)
    parts = [part.astype(np.float32) for part in (trunk, *legs)]
    cut = lambda start, end: tuple(part[start:end] for part in parts)  # noqa: E731
    mass_of = tuple(part[0] for part in parts)
    armature = np.split(model.dof_armature.astype(np.float32), [BASE])
    base = np.diag(armature[0])[:, :, None]
    joints = np.eye(JOINTS, dtype=np.float32)[:, :, None, None] * armature[1].reshape(LEGS, JOINTS).T[:, :, None]
    return Links(mass_of, cut(1, 4), cut(4, 10), cut(10, 16), (base, joints))


def of_link(links: Links, part: int, mass: jax.Array, inertia: jax.Array) -> Inertia:
    """The inertia of a link under factors (N,) on masses and on rotational inertias."""
    wide = (lambda x: x) if part == 0 else (lambda x: x[..., None])
    six = [wide(a) * mass + wide(b) * inertia for a, b in zip(links.offset[part], links.own[part], strict=True)]
    x, y, z = (wide(m) * mass for m in links.moment[part])
    return Inertia(wide(links.mass[part]) * mass, (x, y, z), (six[0], six[1], six[2]), (six[3], six[4], six[5]))
