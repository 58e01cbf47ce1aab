"""A robot's MJCF as MuJoCo compiles it, compared with what was read of it and with what the contact slots assume."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from loco_mjx.errors import UserError
from loco_mjx.robots import LEGS, NJOINT, NQ, NV, PARTS, Robot, joint_names

TOUCHES = 2  # conaffinity of the robot's spheres, contype of a scene's geoms; and the other way about 1
ROUGH = ("foot", "knee")  # the spheres with friction
SEEN = 2  # group of a scene's geoms that cameras see


def compiled(robot: Robot) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The robot by itself.

    Raises:
        UserError: if MuJoCo cannot compile it, or makes of it what does not fit.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(robot.path))
        model = spec.compile()
    except ValueError as error:
        raise UserError(f"'{robot.path}' cannot be compiled: {' '.join(str(error).split())}") from None
    problem = _difference(robot, model) or _unfit(robot, model)
    if problem is not None:
        raise UserError(f"'{robot.path}' is no robot that fits: {problem}; docs/robots.md says what is needed")
    return spec, model


def _difference(robot: Robot, model: mujoco.MjModel) -> str | None:
    """What MuJoCo has otherwise than it was read."""
    if (model.nq, model.nv, model.nu, model.neq, model.ntendon) != (NQ, NV, NJOINT, 0, 0):
        return f"it has more than a free trunk and {NJOINT} joints with a motor each"
    if tuple(model.joint(i + 1).name for i in range(NJOINT)) != joint_names():
        return f"MuJoCo's order of its joints is not {', '.join(joint_names())}"
    spheres = [model.geom(name).id for name in robot.spheres]
    links = [model.body(f"{leg}_{part}") for leg in LEGS for part in PARTS]
    expected: dict[str, tuple[Any, Any]] = {
        "joint axes": ([[1, 0, 0], [0, 1, 0], [0, 1, 0]] * len(LEGS), model.jnt_axis[1:]),
        "joint limits": (np.stack([robot.lower, robot.upper], axis=1), model.jnt_range[1:]),
        "torque limits": (robot.torque_limit, model.actuator_ctrlrange[:, 1]),
        "joint damping": (robot.damping, model.dof_damping[6:]),
        "the legs' links": (_links(robot), [link.pos for link in links]),
        "the legs' directions": ([[1, 0, 0, 0]] * NJOINT, [link.quat for link in links]),
        "the spheres' radii": (robot.radii, model.geom_size[spheres, 0]),
        "the spheres' places": (_places(robot), model.geom_pos[spheres]),
        "the timestep": (robot.physics_dt, model.opt.timestep),
    }
    for name, (read, made) in expected.items():
        if not np.allclose(read, made, atol=2e-3):
            return f"{name} are not, for MuJoCo, what stands in the file"
    return None


def _links(robot: Robot) -> list[tuple[float, ...]]:
    """Where each leg's hip, thigh and calf are in the body before."""
    legs = zip(robot.hips, robot.thigh_offset, strict=True)
    return [place for hip, offset in legs for place in (hip, (0, offset, 0), (0, 0, -robot.thigh_length))]


def _places(robot: Robot) -> list[tuple[float, ...]]:
    """Where each sphere is in its body."""
    x, z = robot.foot
    hips = [(0, offset, 0) for offset in robot.thigh_offset]
    feet, knees, calves = ([place] * len(LEGS) for place in ((x, 0, z), (0, 0, 0), (0.5 * x, 0, 0.5 * z)))
    return [*feet, *hips, *knees, *calves, *(sphere.center for sphere in robot.trunk_spheres)]


def _unfit(robot: Robot, model: mujoco.MjModel) -> str | None:
    """What the contact slots and their solver assume, and the file has otherwise."""
    for name in robot.spheres:
        geom, rough = model.geom(name), name.split("_")[1] in ROUGH
        found = (*geom.contype, *geom.conaffinity, *geom.condim)
        if found != (1, TOUCHES, 3 if rough else 1) or geom.priority[0] < 1:
            wanted = f"contype 1, conaffinity {TOUCHES}, condim {3 if rough else 1}, priority 1"
            return f"geom '{name}' has contype, conaffinity and condim {found}; accepted: {wanted}"
    others = [g for g in range(model.ngeom) if model.geom(g).name not in robot.spheres]
    if model.geom_contype[others].any() or model.geom_conaffinity[others].any():
        return "geoms other than its spheres collide; accepted: contype 0, conaffinity 0"
    if (model.geom_group == SEEN).any():
        return f"it has geoms of group {SEEN}, which are those of a scene that cameras see; accepted: group 1"
    spheres = [model.geom(name).id for name in robot.spheres]
    for kind, solref, solimp in (
        ("spheres", model.geom_solref[spheres], model.geom_solimp[spheres]),
        ("joint limits", model.jnt_solref[1:], model.jnt_solimp[1:]),
    ):
        if np.ptp(solref, axis=0).any() or np.ptp(solimp, axis=0).any():
            return f"its {kind} have several solref or solimp; accepted: the same for all"
        if (solref <= 0).any() or (solimp[:, 4] != 2).any():
            return f"its {kind} have solref {solref[0]} and solimp {solimp[0]}; accepted: solref over 0, power 2"
    if model.opt.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL or not np.allclose(model.opt.gravity, [0, 0, -9.81]):
        return 'its <option> is another; accepted: cone="pyramidal" gravity="0 0 -9.81"'
    return None
