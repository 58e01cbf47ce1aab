"""One control step: the physics steps of a robot against a scene.

Rigid-body dynamics are those of rigid_body.py or MJX; contacts are the tangent planes of collision.py; solver.py solves
for the constraints' forces.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from flax import struct

from loco_mjx.physics import block_matrix, collision, constraint, kinematics, solver
from loco_mjx.physics.batch import together
from loco_mjx.physics.block_matrix import JOINTS, LEGS, DofVector
from loco_mjx.physics.model import PhysicsModel
from loco_mjx.physics.xla import FusionBarrier, add_up, total
from loco_mjx.robots import NJOINT, NV
from loco_mjx.robots.motor import motor_torque
from loco_mjx.scene.types import Scene

Motors = Callable[[jax.Array, jax.Array], jax.Array]  # torques (12, N) of joint angles and velocities


@struct.dataclass
class PhysicsState:
    """What is carried from step to step.

    Attributes:
        qpos: (19,) base position m, base quaternion (w, x, y, z), 12 joint angles rad.
        qvel: (18,) base velocity m/s in the world frame, angular velocity rad/s in the trunk's frame, joints rad/s.
        warmstart: (18,) the last accelerations, where the solver starts.
    """

    qpos: jax.Array
    qvel: jax.Array
    warmstart: jax.Array


@struct.dataclass
class Dynamics:
    """What domain randomisation changes.

    Attributes:
        kp: N·m/rad.
        kd: N·m·s/rad.
        motor_strength: (12,) factor on each motor's torque.
        motor_friction: viscous, N·m·s/rad.
        friction: lateral coefficient of feet and knees.
        mass: factor on every body's mass.
        inertia: factor on every body's rotational inertia.
    """

    kp: jax.Array
    kd: jax.Array
    motor_strength: jax.Array
    motor_friction: jax.Array
    friction: jax.Array
    mass: jax.Array
    inertia: jax.Array


@struct.dataclass
class SubstepTrace:
    """What happened in a control step of n physics steps; index 0 of a trace is before it, n after it.

    Attributes:
        torque_squared: mean over the physics steps of the sum of the motors' squared torques, (N·m)².
        obstacle_contact: bool, whether any sphere touched an obstacle or a wall in any physics step.
        dropped: int32, boxes and cylinders within reach of the robot that it could not feel: it feels only so many.
        angles: (n + 1, 12) joint angles, rad.
        quat: (n + 1, 4) base orientation.
        gyro: (n + 1, 3) angular velocity in the trunk's frame, rad/s.
    """

    torque_squared: jax.Array
    obstacle_contact: jax.Array
    dropped: jax.Array
    angles: jax.Array
    quat: jax.Array
    gyro: jax.Array


def initial_state(qpos: jax.Array) -> PhysicsState:
    """At rest in a pose (19,)."""
    qpos = jp.asarray(qpos, jp.float32)
    return PhysicsState(qpos, jp.zeros(NV, jp.float32), jp.zeros(NV, jp.float32))


def nominal_dynamics(kp: float, kd: float, friction: float = 1.0) -> Dynamics:
    """A robot as it is, without randomisation, under gains kp (N·m/rad) and kd (N·m·s/rad)."""
    one = jp.ones((), jp.float32)
    return Dynamics(kp * one, kd * one, jp.ones(NJOINT, jp.float32), 0.0 * one, friction * one, one, one)


def _integrate(qpos: jax.Array, qvel: jax.Array, timestep: float) -> jax.Array:
    """Position after one physics step at a velocity; (19, N), (18, N)."""
    dt = np.float32(timestep)
    half = qvel[3:6] * (dt * np.float32(0.5))
    angle = jp.sqrt(jp.sum(half * half, axis=0))
    # sin(angle) / angle; below 1e-4 rad that is 1 to float32
    sinc = jp.where(angle > 1e-4, jp.sin(angle) / jp.maximum(angle, 1e-4), 1.0)
    w, x, y, z = qpos[3:7]
    c, (i, j, k) = jp.cos(angle), half * sinc
    turned = [
        w * c - x * i - y * j - z * k,
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
    ]
    quat = jp.stack(turned) / jp.sqrt(add_up(q * q for q in turned))
    return jp.concatenate([qpos[:3] + dt * qvel[:3], quat, qpos[7:] + dt * qvel[6:]])


def physics_step(
    model: PhysicsModel,
    barrier: FusionBarrier,
    candidates: collision.Candidates,
    motors: Motors,
    dynamics: Dynamics,
    state: PhysicsState,
) -> tuple[PhysicsState, jax.Array, collision.ContactSlots]:
    """The next state, the squared torque and what was touched. Environments last in every array."""
    robot, qpos, qvel = model.robot, state.qpos, state.qvel
    torque = motors(qpos[7:], qvel[6:])
    qM, qfrc_bias = model.dynamics(barrier, qpos, qvel, dynamics.mass, dynamics.inertia)
    pose = barrier(lambda qpos: kinematics.pose(robot, qpos), qpos)
    centers = barrier(lambda pose: kinematics.centers(robot, pose), pose)
    contacts = collision.narrowphase(barrier, candidates, robot, centers, model.obstacle_slots)
    constraints = barrier(
        lambda: constraint.constraints(model, pose, qpos, qvel, contacts, dynamics.friction, dynamics.mass)
    )
    # qfrc_smooth = qfrc_actuator + qfrc_passive − qfrc_bias
    of_joints = torque - kinematics.column(robot.damping, qpos) * qvel[6:] if any(robot.damping) else torque
    legs = jp.swapaxes(of_joints.reshape(LEGS, JOINTS, -1), 0, 1)
    qfrc_smooth = DofVector(-qfrc_bias.base, legs - qfrc_bias.joints)
    qacc = block_matrix.join(
        solver.solve(
            barrier,
            solver.Problem(qM, qfrc_smooth, constraints),
            block_matrix.split(state.warmstart),
            model.config.iterations,
            model.config.ls_iterations,
            model.config.more_iterations,
        )
    )
    qvel = qvel + np.float32(robot.physics_dt) * qacc
    new = PhysicsState(_integrate(qpos, qvel, robot.physics_dt), qvel, qacc)
    return new, total(torque * torque), contacts


def last(tree: Any) -> Any:
    """Arrays with the environments on the last axis, of arrays that have them on the first."""
    return jax.tree.map(lambda x: jp.moveaxis(x, 0, -1), tree)


def broadphase(model: PhysicsModel, state: PhysicsState, scene: Scene) -> collision.Candidates:
    """What may touch the robots within a control step, environments last; of arguments that have them first."""
    terrain, flat = scene.terrain, scene.replace(terrain=None)  # type: ignore[attr-defined]
    pick = jax.vmap(lambda scene, qpos: collision.broadphase(scene, model.robot, qpos, model.config))
    # A heightfield is too large to be turned around in every step.
    return last(pick(flat, state.qpos)).replace(terrain=terrain)


def _control_steps(
    model: PhysicsModel, state: PhysicsState, scene: Scene, targets: jax.Array, dynamics: Dynamics
) -> tuple[PhysicsState, SubstepTrace]:
    """:func:`control_step` of N environments, on the first axis of every argument."""
    candidates = broadphase(model, state, scene)
    state, targets, dynamics = last((state, targets, dynamics))
    limit, gains = kinematics.column(model.robot.torque_limit, state.qpos), (dynamics.kp, dynamics.kd)

    def motors(angle: jax.Array, velocity: jax.Array) -> jax.Array:
        return motor_torque(targets, angle, velocity, *gains, limit, dynamics.motor_strength, dynamics.motor_friction)

    def body(state: PhysicsState, i: jax.Array) -> tuple[PhysicsState, tuple[jax.Array, ...]]:
        new, squared, contacts = physics_step(model, FusionBarrier(i >= 0), candidates, motors, dynamics, state)
        return new, (squared, contacts.hit, *traced(new))

    new, happened = jax.lax.scan(body, state, jp.arange(model.robot.substeps))
    out = (new, substep_trace(state, happened, candidates.dropped))
    return jax.tree.map(lambda x: jp.moveaxis(x, -1, 0), out)


def traced(state: PhysicsState) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What a :class:`SubstepTrace` shows of a state: joint angles, orientation, angular velocity."""
    return state.qpos[7:], state.qpos[3:7], state.qvel[3:6]


def substep_trace(first: PhysicsState, happened: tuple[jax.Array, ...], dropped: jax.Array) -> SubstepTrace:
    """What happened in physics steps: squared torque, hit and what :func:`traced` says of each, after ``first``."""
    squared, hit, *after = happened
    trace = [jp.concatenate([before[None], later]) for before, later in zip(traced(first), after, strict=True)]
    return SubstepTrace(jp.mean(squared, axis=0), jp.any(hit, axis=0), dropped, *trace)


def control_step(
    model: PhysicsModel, state: PhysicsState, scene: Scene, targets: jax.Array, dynamics: Dynamics
) -> tuple[PhysicsState, SubstepTrace]:
    """Runs the motors toward targets for one control step (the A1: 0.04 s, 16 physics steps).

    Written for one environment; `jax.vmap` of it computes with the environments on the last axis, and a vmap of that
    (seeds × environments) with all of them together there.

    Args:
        model: the physics.
        state: before the step.
        scene: the world; it stands still during the step.
        targets: (12,) desired joint angles, rad.
        dynamics: gains, friction, masses.

    Returns:
        State after the step, and what happened in it. A state that is not finite stays so.
    """
    steps = lambda *args: _control_steps(model, *args)  # noqa: E731
    return together(steps, (described(state), trace_shapes(model.robot.substeps)))(state, scene, targets, dynamics)


def described(tree: Any) -> Any:
    """The shapes and types of a pytree of arrays."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(jp.shape(x), jp.result_type(x)), tree)


def trace_shapes(count: int) -> Any:
    """The shapes of one environment's :class:`SubstepTrace` of so many physics steps."""

    def of(*shape: int, dtype: Any = jp.float32) -> Any:
        return jax.ShapeDtypeStruct(shape, dtype)

    return SubstepTrace(
        torque_squared=of(),
        obstacle_contact=of(dtype=jp.bool_),
        dropped=of(dtype=jp.int32),
        angles=of(count + 1, NJOINT),
        quat=of(count + 1, 4),
        gyro=of(count + 1, 3),
    )
