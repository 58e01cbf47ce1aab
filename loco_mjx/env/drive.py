"""What drives the robot in a control step: joint targets that are held, or the whole-body controller's ticks.

How large a controller's command is, at which rate it comes and what it means says loco_mjx/controllers.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import EnvConfig
from loco_mjx.controllers import TICK, get_controller, ticks
from loco_mjx.env.action import neutral
from loco_mjx.errors import UserError
from loco_mjx.physics.driven import driven_steps
from loco_mjx.physics.model import PhysicsModel
from loco_mjx.physics.step import Dynamics, PhysicsState, SubstepTrace, control_step
from loco_mjx.robots import Robot
from loco_mjx.scene.types import Scene
from loco_mjx.whole_body import walk
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import body_of


@struct.dataclass
class Moved:
    """What came of a control step, whoever computed its physics.

    Attributes:
        physics: after it.
        memory: of the controller after it.
        trace: what physics traced.
        facts: what the controller says of it, () each, by the names of its metrics.
    """

    physics: PhysicsState
    memory: Any
    trace: SubstepTrace
    facts: dict[str, jax.Array]


class Drive(Protocol):
    """A controller over the physics, for one environment; whoever uses it vmaps it.

    Attributes:
        metrics: names of what it reports of every control step.
    """

    metrics: tuple[str, ...]

    def begin(self, physics: PhysicsState) -> Any:
        """The controller's memory at an episode's start: a pytree, or None."""
        ...

    def move(self, physics: PhysicsState, memory: Any, scene: Scene, command: jax.Array, dynamics: Dynamics) -> Moved:
        """One control step under a command, relative to `neutral` (loco_mjx/env/action.py)."""
        ...


class JointTargets:
    """Controller `pd`: every motor is drawn to its target for the whole control step."""

    metrics: tuple[str, ...] = ()

    def __init__(self, model: PhysicsModel, config: EnvConfig) -> None:
        self._model, self._pose = model, neutral(config)

    def begin(self, physics: PhysicsState) -> None:
        """It remembers nothing."""

    def move(self, physics: PhysicsState, memory: Any, scene: Scene, command: jax.Array, dynamics: Dynamics) -> Moved:
        """Targets of the default pose plus the command (12,), rad."""
        physics, trace = control_step(self._model, physics, scene, jp.array(self._pose) + command, dynamics)
        return Moved(physics, memory, trace, {})


class WholeBody:
    """Controller `mpc`: walks as it is commanded, looking at the robot every 5 ms.

    Its memory is a :class:`loco_mjx.physics.driven.Driven` without the robot's state, which the environment holds.
    """

    metrics: tuple[str, ...] = ("unsolved",)

    def __init__(self, model: PhysicsModel, config: EnvConfig) -> None:
        """Prepares the controller.

        Raises:
            UserError: if the robot's physics have no whole number of steps in a tick.
        """
        robot, rate = model.robot, get_controller(config.controller).rate(model.robot)
        self._size = ticks(rate), substeps(robot)
        self._model, self._config, self._body = model, WholeBodyConfig(), body_of(robot)
        self._controller = walk.make_controller(self._config, self._body)

    def begin(self, physics: PhysicsState) -> Any:
        """About to walk, from standing."""
        return walk.start(self._config, self._body, physics).replace(physics=None)  # type: ignore[attr-defined]

    def move(self, physics: PhysicsState, memory: Any, scene: Scene, command: jax.Array, dynamics: Dynamics) -> Moved:
        """Ticks with speed ahead and yaw rate (2,) wanted; `unsolved`: how many had a program that was not solved."""
        driven = walk.commanded(memory.replace(physics=physics), command)
        driven, trace, facts = driven_steps(self._model, self._controller, driven, scene, dynamics, *self._size)
        unsolved = jp.sum(facts.unsolved).astype(jp.float32)
        return Moved(driven.physics, driven.replace(physics=None), trace, {"unsolved": unsolved})  # type: ignore[attr-defined]


def substeps(robot: Robot) -> int:
    """Physics steps of a robot in a tick of the whole-body controller.

    Raises:
        UserError: if they are no whole number.
    """
    count = round(TICK / robot.physics_dt)
    if abs(count * robot.physics_dt - TICK) > 1e-9:
        raise UserError(
            f"robot '{robot.name}' has physics steps of {robot.physics_dt} s; accepted, for controller 'mpc': a whole "
            f"number of them in {TICK} s"
        )
    return count


DRIVES: dict[str, Callable[[PhysicsModel, EnvConfig], Drive]] = {"pd": JointTargets, "mpc": WholeBody}


def make_drive(model: PhysicsModel, config: EnvConfig) -> Drive:
    """The controller of a configuration.

    Raises:
        UserError: if it does not fit the robot.
    """
    return DRIVES[config.controller](model, config)
