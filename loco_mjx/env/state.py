"""What an environment hands from step to step, and what of it belongs to an episode."""

from __future__ import annotations

from typing import Any

import jax
from flax import struct

from loco_mjx.env.randomization import Randomization
from loco_mjx.physics.step import PhysicsState
from loco_mjx.scene.types import Scene


class State(struct.PyTreeNode):
    """One environment between two control steps; batches come from ``jax.vmap``.

    The fields' names and meanings are those of ``brax.envs.base.State``, so that Brax's wrappers, its evaluator and its
    learners take this class for theirs. They write into `metrics` and `info`: each state's dicts are its own, and
    what a wrapper has added to them is kept by ``step``.

    Attributes:
        pipeline_state: everything that belongs to the episode: the simulation's state, its histories, its clock.
        obs: arrays by name; see :class:`loco_mjx.env.loco_env.LocoEnv`.
        reward: () of the last step.
        done: () 1.0 where the episode has ended, by itself or at a time limit.
        metrics: () each, the last step's increments.
        info: what outlives an episode (`key`), and `truncation`: () 1.0 where it ended at a time limit.
    """

    pipeline_state: Any
    obs: Any
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, Any] = struct.field(default_factory=dict)
    info: dict[str, Any] = struct.field(default_factory=dict)


@struct.dataclass
class Episode:
    """What an episode remembers of itself.

    Attributes:
        step: () int32, control steps taken.
        start: (3,) where the base started, world frame, m.
        first_obstacle: () x from which contacts count as collisions, m.
        last_action: (12,) joint targets of the last step relative to the default pose, rad; under the whole-body
            controller its command (2,), m/s and rad/s.
        history: proprioceptive frames by sensor, (frames, size) each, newest first.
    """

    step: jax.Array
    start: jax.Array
    first_obstacle: jax.Array
    last_action: jax.Array
    history: dict[str, jax.Array]


@struct.dataclass
class World:
    """All that begins anew with an episode: whoever puts back a first World, as Brax's AutoResetWrapper does, resets.

    Attributes:
        physics: positions and velocities of the robot.
        scene: the world it walks in.
        randomization: this episode's dynamics and latency.
        episode: its clock, its start and its histories.
        control: what the controller remembers; see :mod:`loco_mjx.env.drive`.
    """

    physics: PhysicsState
    scene: Scene
    randomization: Randomization
    episode: Episode
    control: Any = None
