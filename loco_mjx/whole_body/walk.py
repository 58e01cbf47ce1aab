"""The whole-body controller over MJX's physics: what it drives is truly measured, feet feel what they touch."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jp

from loco_mjx.physics.driven import Controller, Driven, begin
from loco_mjx.physics.step import PhysicsState
from loco_mjx.robots.motor import MotorCommand
from loco_mjx.whole_body import controller, solver
from loco_mjx.whole_body.arrays import rotation
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.controller import Facts, Measured, State
from loco_mjx.whole_body.legs import Body


class Memory(NamedTuple):
    """What the controller carries.

    Attributes:
        state: its own.
        command: (2,) speed ahead, m/s, and yaw rate, rad/s, that it is to walk with.
    """

    state: State
    command: jax.Array


def measure(physics: PhysicsState, contacts: jax.Array) -> Measured:
    """What perfect sensors measure; contacts (4,) bool."""
    quat, qvel = physics.qpos[3:7], physics.qvel
    return Measured(quat, qvel[3:6], rotation(quat).T @ qvel[:3], physics.qpos[7:], contacts)


def start(config: WholeBodyConfig, body: Body, physics: PhysicsState) -> Driven:
    """A robot that stands, about to walk."""
    return begin(physics, Memory(controller.begin(config, body, physics.qpos[7:]), jp.zeros(2, jp.float32)))


def commanded(driven: Driven, command: jax.Array) -> Driven:
    """The same with another command (2,)."""
    return driven.replace(memory=driven.memory._replace(command=command))  # type: ignore[attr-defined]


def make_controller(config: WholeBodyConfig, body: Body) -> Controller:
    """The controller, as :func:`loco_mjx.physics.driven.driven_steps` takes one."""
    solve = solver.make_solver(config.mpc)

    def tick(memory: Memory, physics: PhysicsState, contacts: jax.Array) -> tuple[MotorCommand, Memory, Facts]:
        told, state, facts = controller.tick(
            config, body, solve, memory.state, memory.command, measure(physics, contacts)
        )
        return told, memory._replace(state=state), facts

    return tick
