"""A rollout of the whole-body controller under a constant command, in place of a policy."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jp

from loco_mjx.config import EnvConfig
from loco_mjx.env.state import State
from loco_mjx.errors import UserError
from loco_mjx.physics.driven import Driven, driven_steps
from loco_mjx.robots import NJOINT
from loco_mjx.show.rollout import Agent, Moment, Rollout
from loco_mjx.whole_body import walk
from loco_mjx.whole_body.config import TICK, WholeBodyConfig
from loco_mjx.whole_body.legs import body_of


class Walking(Rollout):
    """Episodes in the environment's scenes, its control steps made of the controller's ticks.

    Attributes:
        unsolved: quadratic programs so far that the solver did not solve.
    """

    def __init__(self, agent: Agent, config: EnvConfig, command: tuple[float, float]) -> None:
        """Builds environment and controller; programs compile on first use.

        Args:
            agent: one that stands still: what moves the robot is the controller.
            config: of the environment.
            command: speed ahead, m/s, and yaw rate, rad/s.

        Raises:
            UserError: if the robot's physics have no whole number of steps in a tick, or a control step of ticks.
        """
        super().__init__(agent, config)
        robot, self._config = self.env.robot, WholeBodyConfig()
        substeps = round(TICK / robot.physics_dt)
        if abs(substeps * robot.physics_dt - TICK) > 1e-9 or robot.substeps % substeps:
            raise UserError(
                f"robot '{robot.name}' has physics steps of {robot.physics_dt} s and {robot.policy_hz} control steps "
                f"a second; accepted: a whole number of steps in a tick of {TICK} s, and of ticks in a control step"
            )
        self._size = (robot.substeps // substeps, substeps)
        self._command, self._body = jp.array(command, jp.float32), body_of(robot)
        self._controller = walk.make_controller(self._config, self._body)
        self._walk = jax.jit(self._walked)
        self._step = self._advance  # type: ignore[assignment]  # compiled in its parts
        self._driven: Driven
        self.unsolved = 0

    def _begin(self) -> Moment:
        moment = super()._begin()
        physics = self._state.pipeline_state.physics
        self._driven = walk.commanded(walk.start(self._config, self._body, physics), self._command)
        return moment

    def _advance(self, state: State, action: jax.Array) -> State:
        """One control step; the agent's action is not looked at."""
        state, self._driven, unsolved = self._walk(state, self._driven)
        self.unsolved += int(unsolved)
        return state

    def _walked(self, state: State, driven: Driven) -> tuple[State, Driven, jax.Array]:
        world: Any = state.pipeline_state
        scene = self.env.next_scene(state)
        driven = driven.replace(physics=world.physics)  # type: ignore[attr-defined]
        how = world.randomization.dynamics
        driven, trace, facts = driven_steps(self.env.physics, self._controller, driven, scene, how, *self._size)
        state = self.env.finish_step(state, scene, driven.physics, trace, jp.zeros(NJOINT))
        return self.env.observe(state), driven, jp.sum(facts.unsolved)
