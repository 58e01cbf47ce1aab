"""An episode in our own environment, step by step, with what the agent saw and where it looked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx import controllers
from loco_mjx.config import Config, EnvConfig, preset
from loco_mjx.controllers import CONTROLLERS
from loco_mjx.depth.encoding import decode
from loco_mjx.env import LocoEnv
from loco_mjx.errors import UserError
from loco_mjx.evaluation.episodes import evaluation_config, keys_of
from loco_mjx.networks.outputs import DEPTH
from loco_mjx.ppo.actor import Held
from loco_mjx.robots import DEFAULT
from loco_mjx.run.policy import TrainedPolicy, observation_shapes
from loco_mjx.scene.types import Scene

Kind = Literal["policy", "zero", "random", "mpc"]


@dataclass(frozen=True)
class Moment:
    """One control step, as it is drawn.

    Attributes:
        qpos: (19,) configuration of the robot.
        scene: the world, obstacles where they are now.
        depth: (H, W) m, the newest frame of the observation; None where the environment has no camera.
        attention: (N·N,) of the state token to the visual tokens on this observation; None for agents without.
        episode: its number in this rollout.
        step: of the episode, control steps.
        distance: m covered in the episode so far, as evaluation counts it.
        done: whether the episode has ended here; the next step begins another.
    """

    qpos: np.ndarray
    scene: Scene
    depth: np.ndarray | None
    attention: np.ndarray | None
    episode: int
    step: int
    distance: float
    done: bool


class Agent:
    """What acts: a trained policy's mean, the default pose (zero), noise, or a command to the whole-body controller."""

    def __init__(
        self,
        kind: Kind,
        policy: TrainedPolicy | None = None,
        robot: str = DEFAULT,
        command: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Takes a policy for kind "policy"; the others need none, and stand in the policy's environment if it is given.

        Without a policy it is `robot`, by name or path, that acts; with kind "mpc" it walks by a constant command,
        speed ahead, m/s, and yaw rate, rad/s.

        Raises:
            UserError: if a policy is asked for and there is none.
        """
        if kind == "policy" and policy is None:
            raise UserError("there is no policy to run; accepted: the directory of a run, or the zero or random agent")
        self.kind, self.policy = kind, policy if kind == "policy" else None
        self.given, self.robot = policy, robot  # for another agent in its place
        own = kind if kind in CONTROLLERS else controllers.DEFAULT
        self._config: Config = policy.config if policy is not None else preset("fast", robot, own)
        self._command = command

    def env_config(self, task: str | None = None) -> EnvConfig:
        """The environment to act in: the policy's own or the default, without randomisation."""
        return evaluation_config(self._config.env, task)

    @property
    def attends(self) -> bool:
        """Whether there is attention from a state token to draw."""
        if self.policy is None:
            return False
        shapes = observation_shapes(self.policy.config)
        obs = {name: jax.ShapeDtypeStruct(shape, jp.float32) for name, shape in shapes.items()}
        apply = self.policy.networks.apply
        return jax.eval_shape(lambda obs: apply(self.policy.params, obs), obs).attention is not None  # type: ignore[union-attr]

    def start(self, obs: dict[str, jax.Array]) -> Held:
        """The depth that is held before an episode's first step."""
        return None if self.policy is None else self.policy.actor().start(obs)

    def act(
        self, obs: dict[str, jax.Array], held: Held, step: jax.Array, key: jax.Array, size: int
    ) -> tuple[jax.Array, jax.Array | None, Held]:
        """(size,) action in [−1, 1] at a step of the episode, the attention if there is any, and the depth held."""
        if self.kind == "zero":
            return jp.zeros(size), None, None
        if self.kind == "mpc":
            return jp.clip(jp.array(self._command) / jp.array(CONTROLLERS["mpc"].scale), -1.0, 1.0), None, None
        if self.policy is None:
            return jax.random.uniform(key, (size,), minval=-1.0, maxval=1.0), None, None  # action = +U(−1, 1)
        outputs, held = self.policy.actor().outputs(obs, held, step)
        return jp.tanh(outputs.mean), outputs.attention, held


class Rollout:
    """Episodes one after another; episode i of a seed is the one `loco-mjx evaluate` runs as its i-th.

    Attributes:
        unsolved: the whole-body controller's programs so far that were not solved; None without it.
    """

    def __init__(self, agent: Agent, config: EnvConfig) -> None:
        """Builds the environment; programs compile on first use.

        Raises:
            UnknownNameError: if the task is unknown.
        """
        self.agent, self.config = agent, config
        self.env = LocoEnv(config)
        self._reset = jax.jit(self.env.reset)
        self._step = jax.jit(self.env.step)
        self._act = jax.jit(self._decide)
        self.seed, self.episode = 0, 0
        self._distance = 0.0
        self.unsolved: int | None = None if config.controller == controllers.DEFAULT else 0
        self._state: Any = None  # these three: of the current moment, from reset on
        self._action: Any = None
        self._moment: Moment

    def with_agent(self, agent: Agent) -> Rollout:
        """The same compiled environment with another agent."""
        other = Rollout(agent, self.config)
        other.env, other._reset, other._step = self.env, self._reset, self._step
        return other

    def reset(self, seed: int) -> Moment:
        """Begins the seed's first episode."""
        self.seed, self.episode = seed, 0
        return self._begin()

    def step(self) -> Moment:
        """One control step; after an episode's end, the first moment of the next one in another scene."""
        if self._moment.done:
            self.episode += 1
            return self._begin()
        self._state = self._step(self._state, self._action)
        self._distance += float(self._state.metrics["distance"])
        if self.unsolved is not None:
            self.unsolved += int(self._state.metrics["unsolved"])
        return self._look()

    def _begin(self) -> Moment:
        start, self._key = keys_of(self.seed, jp.asarray(self.episode))
        self._state = self._reset(start)
        self._held, self._distance = self.agent.start(self._state.obs), 0.0
        return self._look()

    def _decide(self, obs: Any, held: Any, step: jax.Array, key: jax.Array) -> tuple[jax.Array, Any, Any]:
        return self.agent.act(obs, held, step, jax.random.fold_in(key, step), self.env.action_size)

    def _look(self) -> Moment:
        state = self._state
        world = state.pipeline_state
        step = world.episode.step
        self._action, attention, self._held = self._act(state.obs, self._held, step, self._key)
        frames = state.obs.get(DEPTH)
        self._moment = Moment(
            qpos=np.asarray(world.physics.qpos, np.float64),
            scene=world.scene,
            depth=None if frames is None else np.asarray(decode(frames[..., 0])),
            attention=None if attention is None else np.asarray(attention),
            episode=self.episode,
            step=int(step),
            distance=self._distance,
            done=bool(state.done),
        )
        return self._moment
