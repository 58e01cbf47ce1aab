"""The whole-body controller: one tick of 5 ms, for one robot, in NumPy or JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from loco_mjx.controllers import SPEED_LIMIT, TICK, YAW_RATE_LIMIT
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import gait, legs, mpc, swing
from loco_mjx.whole_body.arrays import Array, level, rotation, space
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import Body


class Solution(NamedTuple):
    """What a solver found.

    Attributes:
        forces: (horizon, 4, 3) N, on the feet, in the level frame.
        converged: bool.
        iterations: int32.
    """

    forces: Array
    converged: Array
    iterations: Array


Solver = Callable[[mpc.Problem], Solution]


class Measured(NamedTuple):
    """What is measured of the robot.

    Attributes:
        quat: (4,) orientation of the trunk (w, x, y, z).
        gyro: (3,) its angular velocity in its own frame, rad/s.
        velocity: (3,) its velocity in its own frame, m/s.
        angles: (12,) rad.
        contacts: (4,) bool, which feet touch something.
    """

    quat: Array
    gyro: Array
    velocity: Array
    angles: Array
    contacts: Array


class State(NamedTuple):
    """What is carried from tick to tick.

    Attributes:
        tick: int32, ticks so far.
        swings: (4,) bool, which legs swung by the clock.
        lifted: (4, 3) where each foot was when it began to swing, in the trunk's frame, m.
        forces: (4, 3) the last that a solver found, N.
        height: of the trunk above the feet, m, as it was last measured.
        failed: int32, programs in a row that were not solved.
    """

    tick: Array
    swings: Array
    lifted: Array
    forces: Array
    height: Array
    failed: Array


class Facts(NamedTuple):
    """What happened in a tick.

    Attributes:
        iterations: int32, of the solver.
        unsolved: bool, the program was not solved and the last forces stood in.
        clipped: bool, the command was beyond the limits.
        pushes: (4,) bool, which legs pushed.
        early: (4,) bool, which of them had touched ground early.
        lost: (4,) bool, which of them touched nothing.
    """

    iterations: Array
    unsolved: Array
    clipped: Array
    pushes: Array
    early: Array
    lost: Array


class Sensed(NamedTuple):
    """What the controller makes of what is measured; the level frame has the world's z, and x is the heading.

    Attributes:
        feet: (4, 3) in the trunk's frame, m.
        attitude: (3, 3) from the trunk's frame into the level one.
        pose: (6,) roll, pitch, 0, 0, 0 and height above the feet, rad and m.
        rates: (6,) angular velocity and velocity in the level frame, rad/s and m/s.
    """

    feet: Array
    attitude: Array
    pose: Array
    rates: Array


def begin(config: WholeBodyConfig, body: Body, angles: Array) -> State:
    """The state before the first tick, of a robot that stands."""
    xp, kind = space(angles), angles.dtype
    forces = np.zeros((4, 3), kind)
    forces[:, 2] = body.mass * mpc.GRAVITY / 4
    none = xp.zeros((), np.int32)
    feet = legs.feet(body, angles).astype(kind)
    return State(none, xp.zeros(4, bool), feet, xp.asarray(forces), xp.asarray(config.height, kind), none)


def clip(command: Array) -> Array:
    """(2,) speed ahead and yaw rate, within the limits."""
    limits = np.array([SPEED_LIMIT, YAW_RATE_LIMIT], command.dtype)
    return space(command).clip(command, -limits, limits)


def tick(
    config: WholeBodyConfig, body: Body, solve: Solver, state: State, command: Array, measured: Measured
) -> tuple[MotorCommand, State, Facts]:
    """One tick.

    Args:
        config: of the controller.
        body: of the robot.
        solve: a quadratic program's solver.
        state: of the controller.
        command: (2,) speed ahead, m/s, and yaw rate, rad/s; clipped to the limits.
        measured: of the robot.

    Returns:
        What the motors are told until the next tick, the controller's state then, and what happened.
    """
    xp, kind = space(measured.angles), measured.angles.dtype
    wanted = clip(command)
    time = (state.tick * TICK).astype(kind)
    now = gait.phase(config.gait, time)
    mode = gait.mode(config.gait, now, measured.contacts)
    sensed = sense(body, state, measured, mode)
    lifted = xp.where((now.swings & ~state.swings)[:, None], sensed.feet, state.lifted)

    solution = solve(program(config, body, sensed, time, mode.pushes, wanted))
    good = solution.converged & xp.all(xp.isfinite(solution.forces[0]))
    forces = xp.where(good, solution.forces[0], state.forces).astype(kind)

    out = _motors(config, body, measured, sensed, now, mode.pushes, lifted, forces, wanted)
    failed = xp.where(good, 0, state.failed + 1).astype(np.int32)
    new = State((state.tick + 1).astype(np.int32), now.swings, lifted, forces, sensed.pose[5], failed)
    return out, new, Facts(solution.iterations, ~good, xp.any(wanted != command), *mode)


def sense(body: Body, state: State, measured: Measured, mode: gait.Mode) -> Sensed:
    """Where the trunk is and how it moves; its height is the mean above the feet that stand on something."""
    xp, kind = space(measured.angles), measured.angles.dtype
    tilt, attitude = level(rotation(measured.quat))
    feet = legs.feet(body, measured.angles).astype(kind)
    stands = mode.pushes & ~mode.lost
    below = -(feet @ attitude[2])
    mean = xp.sum(xp.where(stands, below, 0.0)) / xp.maximum(xp.sum(stands), 1)
    height = xp.where(xp.any(stands), mean, state.height).astype(kind)
    pose = xp.concatenate([tilt, xp.zeros(3, kind), height[None]])
    rates = xp.concatenate([attitude @ measured.gyro, attitude @ measured.velocity])
    return Sensed(feet, attitude, pose, rates)


def program(
    config: WholeBodyConfig, body: Body, sensed: Sensed, time: Array, pushes: Array, command: Array
) -> mpc.Problem:
    """The stance forces' quadratic program at a time, s, while some legs push, (4,) bool."""
    xp, horizon = space(pushes), config.mpc.horizon
    if config.mpc.foresee:
        later = time + np.arange(1, horizon, dtype=time.dtype) * np.asarray(config.mpc.dt, time.dtype)
        planned = xp.concatenate([pushes[None], ~gait.phase(config.gait, later).swings])
    else:
        planned = xp.broadcast_to(pushes, (horizon, 4))
    effect = mpc.effect(body, sensed.attitude, sensed.feet)
    gradient = mpc.gradient(config.mpc, sensed.pose, sensed.rates, command, config.height)
    return mpc.Problem(gradient, effect, planned, xp.asarray(body.mass * mpc.GRAVITY, sensed.pose.dtype))


def _motors(
    config: WholeBodyConfig,
    body: Body,
    measured: Measured,
    sensed: Sensed,
    now: gait.Phase,
    pushes: Array,
    lifted: Array,
    forces: Array,
    command: Array,
) -> MotorCommand:
    """Torques τ = −Jᵀ f where legs push, joint angles where they swing."""
    xp, kind = space(forces), forces.dtype
    jacobian = legs.jacobians(body, measured.angles)
    torque = -xp.einsum("lij,li->lj", jacobian, forces @ sensed.attitude).reshape(12)
    goals = swing.footholds(config, body, sensed.attitude, sensed.rates, command)
    angles = legs.angles_for(body, swing.way(config, lifted, goals, now.part))
    pushing = xp.repeat(pushes, 3)
    gains = np.full(12, config.swing.kp, kind), np.tile(np.array(config.swing.kd, kind), 4)
    return MotorCommand(
        angles=xp.where(pushing, measured.angles, angles).astype(kind),
        velocities=xp.zeros(12, kind),
        kp=xp.where(pushing, 0.0, gains[0]).astype(kind),
        kd=xp.where(pushing, 0.0, gains[1]).astype(kind),
        torque=xp.where(pushing, xp.clip(torque, -body.torque, body.torque), 0.0).astype(kind),
    )
