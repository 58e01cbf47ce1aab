"""What a physics step needs to know of a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import mujoco
import numpy as np

from loco_mjx import ranges
from loco_mjx.config import PhysicsConfig
from loco_mjx.errors import UserError
from loco_mjx.physics import block_matrix, rigid_body
from loco_mjx.physics.compiled import compiled
from loco_mjx.physics.links import links
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.robots import Robot

# FusionBarrier, qpos (19, N), qvel (18, N), mass (N,), inertia (N,)
RigidBody = Callable[
    [FusionBarrier, jax.Array, jax.Array, jax.Array, jax.Array], tuple[block_matrix.BlockMatrix, block_matrix.DofVector]
]


@dataclass(frozen=True)
class SolverParameters:
    """MuJoCo's solref and solimp of a constraint, as the numbers its formulas use.

    Attributes:
        k: stiffness, 1/s².
        b: damping, 1/s.
        dmin: impedance at no violation.
        dmax: impedance from `width` on.
        width: m or rad.
        midpoint: where the impedance's sigmoid bends, as a fraction of the width.
    """

    k: float
    b: float
    dmin: float
    dmax: float
    width: float
    midpoint: float


@dataclass(frozen=True, eq=False)
class PhysicsModel:
    """The robot and what is static about its constraints.

    Attributes:
        robot: whose it is.
        dynamics: its mass matrix and bias forces, of barrier, qpos, qvel and factors on mass and inertia.
        sphere_invweight: (S,) translational inverse weight of each sphere's body, 1/kg.
        joint_invweight: (12,) inverse weight of each joint, 1/(kg m²).
        contact_parameters: of contacts.
        limit_parameters: of joint limits.
        config: the solver's settings.
        obstacle_slots: per foot, how many boxes and cylinders it can touch at once, beside the ground.
    """

    robot: Robot
    dynamics: RigidBody
    sphere_invweight: np.ndarray
    joint_invweight: np.ndarray
    contact_parameters: SolverParameters
    limit_parameters: SolverParameters
    config: PhysicsConfig
    obstacle_slots: int


def _solver_parameters(solref: np.ndarray, solimp: np.ndarray, timestep: float) -> SolverParameters:
    """From one constraint's solref, in the form (time constant, damping ratio), and its solimp."""
    dmin, dmax, width, midpoint, power = (float(x) for x in solimp)
    assert power == 2.0 and (solref > 0).all(), "loco_mjx/physics/compiled.py refuses others"
    timeconst, dampratio = max(float(solref[0]), 2 * timestep), float(solref[1])
    k = 1 / (dmax * timeconst * dampratio) ** 2  # k = 1 / (dmax · timeconst · dampratio)²
    b = 2 / (dmax * timeconst)  # b = 2 / (dmax · timeconst)
    return SolverParameters(k, b, dmin, dmax, width, midpoint)


def _dynamics(robot: Robot, config: PhysicsConfig, spec: mujoco.MjSpec, model: mujoco.MjModel) -> RigidBody:
    if config.dynamics == "mjx":
        from loco_mjx.physics.mjx import MjxDynamics

        return MjxDynamics(spec)
    return partial(rigid_body.qM_and_qfrc_bias, robot, links(model))


def build(robot: Robot, config: PhysicsConfig, obstacle_slots: int = 2) -> PhysicsModel:
    """Builds the physics.

    Args:
        robot: whose.
        config: solver settings, and how many boxes and cylinders are near.
        obstacle_slots: per foot, how many boxes and cylinders it can touch at once, beside the ground.

    Raises:
        UserError: on sizes that make no sense, or an MJCF that MuJoCo reads otherwise than `robot` says.
    """
    ranges.check(config, "physics")
    if obstacle_slots < 1:
        raise UserError(f"obstacle_slots is {obstacle_slots}; accepted: 1 or more")
    spec, full = compiled(robot)
    spheres = [full.geom(name).id for name in robot.spheres]
    step = full.opt.timestep
    return PhysicsModel(
        robot=robot,
        dynamics=_dynamics(robot, config, spec, full),
        sphere_invweight=full.body_invweight0[full.geom_bodyid[spheres], 0].astype(np.float32),
        joint_invweight=full.dof_invweight0[6:].astype(np.float32),
        contact_parameters=_solver_parameters(full.geom_solref[spheres[0]], full.geom_solimp[spheres[0]], step),
        limit_parameters=_solver_parameters(full.jnt_solref[1], full.jnt_solimp[1], step),
        config=config,
        obstacle_slots=obstacle_slots,
    )
