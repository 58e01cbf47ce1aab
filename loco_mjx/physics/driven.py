"""Physics steps under a controller that looks at the robot every few of them: motors by angle, speed and torque.

A control step (step.py) has one set of joint targets. Here a controller is asked for a command at every tick, and its
command is what Unitree's motors take: joint angles, velocities and gains, and a torque beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.physics.batch import together
from loco_mjx.physics.block_matrix import LEGS
from loco_mjx.physics.kinematics import column
from loco_mjx.physics.model import PhysicsModel
from loco_mjx.physics.step import (
    Dynamics,
    Motors,
    PhysicsState,
    SubstepTrace,
    broadphase,
    described,
    last,
    physics_step,
    substep_trace,
    trace_shapes,
    traced,
)
from loco_mjx.physics.xla import FusionBarrier
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.scene.types import Scene


@struct.dataclass
class Driven:
    """A robot and what drives it.

    Attributes:
        physics: of the robot.
        contacts: (4,) bool, which feet touched something in the last physics step.
        memory: of the controller, a pytree.
    """

    physics: PhysicsState
    contacts: jax.Array
    memory: Any


Controller = Callable[[Any, PhysicsState, jax.Array], tuple[MotorCommand, Any, Any]]


def begin(physics: PhysicsState, memory: Any) -> Driven:
    """A robot that stands on all feet, and its controller's memory."""
    return Driven(physics, jp.ones(LEGS, bool), memory)


def _motors(model: PhysicsModel, command: MotorCommand, dynamics: Dynamics) -> Motors:
    """The law of the motors under a command, environments last."""

    def torque(angle: jax.Array, velocity: jax.Array) -> jax.Array:
        limit = column(model.robot.torque_limit, angle)
        wanted = command.torque + command.kp * (command.angles - angle) + command.kd * (command.velocities - velocity)
        return jp.clip(dynamics.motor_strength * wanted - dynamics.motor_friction * velocity, -limit, limit)

    return torque


def _run(
    model: PhysicsModel,
    controller: Controller,
    ticks: int,
    substeps: int,
    driven: Driven,
    scene: Scene,
    dynamics: Dynamics,
) -> tuple[Driven, SubstepTrace, Any]:
    """:func:`driven_steps` of N environments, on the first axis of every argument."""
    candidates = broadphase(model, driven.physics, scene)
    state, contacts, how = last((driven.physics, driven.contacts, dynamics))
    first = lambda tree: jax.tree.map(lambda x: jp.moveaxis(x, -1, 0), tree)  # noqa: E731

    def step(carry: tuple[PhysicsState, jax.Array], i: jax.Array, motors: Motors) -> tuple[Any, tuple[jax.Array, ...]]:
        new, squared, touched = physics_step(model, FusionBarrier(i >= 0), candidates, motors, how, carry[0])
        on = jp.any(jp.stack([plane.distance < 0.0 for plane in touched.feet]), axis=0)
        return (new, on), (squared, touched.hit, *traced(new))

    def tick(carry: Any, i: jax.Array) -> tuple[Any, Any]:
        state, contacts, memory = carry
        command, memory, facts = jax.vmap(controller)(memory, *first((state, contacts)))
        motors = _motors(model, last(command), how)
        steps = jp.arange(substeps) + i
        (state, contacts), trace = jax.lax.scan(lambda at, j: step(at, j, motors), (state, contacts), steps)
        return (state, contacts, memory), (trace, facts)

    carry = (state, contacts, driven.memory)
    (new, contacts, memory), (trace, facts) = jax.lax.scan(tick, carry, jp.arange(ticks))
    happened = jax.tree.map(lambda x: x.reshape(ticks * substeps, *x.shape[2:]), trace)
    turned = first((new, contacts, substep_trace(state, happened, candidates.dropped)))
    facts = jax.tree.map(lambda x: jp.moveaxis(x, 1, 0), facts)
    return Driven(turned[0], turned[1], memory), turned[2], facts


def driven_steps(
    model: PhysicsModel,
    controller: Controller,
    driven: Driven,
    scene: Scene,
    dynamics: Dynamics,
    ticks: int,
    substeps: int,
) -> tuple[Driven, SubstepTrace, Any]:
    """Ticks of a controller, each followed by physics steps under its command.

    Written for one environment; `jax.vmap` of it, and a vmap of that, computes with all of them together.

    Args:
        model: the physics.
        controller: of one robot, from its memory, the robot's state and which feet (4,) touch something to a command,
            its next memory, and whatever else is to be known of the tick.
        driven: robot and controller before.
        scene: the world; it stands still meanwhile.
        dynamics: strength and friction of motors, friction, masses; its gains are not used.
        ticks: how many.
        substeps: physics steps of each.

    Returns:
        Robot and controller afterwards, what happened, and the controller's facts (ticks, ...).
    """
    run = lambda *args: _run(model, controller, ticks, substeps, *args)  # noqa: E731
    facts = jax.eval_shape(controller, driven.memory, driven.physics, driven.contacts)[2]
    facts = jax.tree.map(lambda x: jax.ShapeDtypeStruct((ticks, *x.shape), x.dtype), facts)
    shapes = (described(driven), trace_shapes(ticks * substeps), facts)
    return together(run, shapes)(driven, scene, dynamics)
