"""A point on a line that wants to be at 1, as small as an environment can be, and a learner for it."""

from __future__ import annotations

import contextlib
import dataclasses
import resource
from collections.abc import Iterator
from functools import cache
from typing import Any

import jax
import jax.numpy as jp
from jax.sharding import Mesh

from loco_mjx.config import Config, EnvConfig, NetworkConfig, PPOConfig
from loco_mjx.env.state import State
from loco_mjx.ppo.multi_seed import SeedsTrainer
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.sharding import make_mesh

HORIZON = 10


class TinyEnv:
    """Action: a push. Observation: place and time. Reward: closeness to the scene's place."""

    action_size = 1
    dt = 0.04

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        return {"state": (2,)}

    def make_pool(self, key: jax.Array, size: int) -> jax.Array:
        return jax.random.uniform(key, (size,))

    def draw(self, key: jax.Array, scenes: jax.Array) -> jax.Array:
        return scenes[jax.random.randint(key, (), 0, scenes.shape[0])]

    def reset_to(self, key: jax.Array, scene: jax.Array) -> State:
        info = {"steps": jp.zeros((), jp.int32), "truncation": jp.zeros(()), "goal": scene}
        place = jax.random.normal(key) * 0.1
        return State(place, {"state": jp.zeros(2)}, jp.zeros(()), jp.zeros(()), {"distance": jp.zeros(())}, info)

    def advance(self, state: State, action: jax.Array) -> State:
        place = state.pipeline_state + 0.1 * action[0]
        steps = state.info["steps"] + 1
        done = (steps >= HORIZON).astype(jp.float32)
        return state.replace(
            pipeline_state=place,
            reward=1.0 - jp.abs(place - state.info["goal"]),
            done=done,
            metrics={"distance": place - state.pipeline_state},
            info=state.info | {"steps": steps, "truncation": done},
        )

    def observe(self, state: State) -> State:
        time = state.info["steps"].astype(jp.float32) / HORIZON
        return state.replace(obs={"state": jp.stack([state.pipeline_state, time])})

    def reset(self, key: jax.Array) -> State:
        return self.observe(self.reset_to(key, jp.ones(())))

    def step(self, state: State, action: jax.Array) -> State:
        return self.observe(self.advance(state, action))


def tiny_config(iterations: int = 6, **ppo: Any) -> Config:
    """Iterations of 4 environments × 8 steps; the pool changes every second one."""
    sizes = {"num_envs": 4, "unroll": 8, "minibatch": 16, "epochs": 2, "pool_size": 4, "pool_refresh": 2}
    values = sizes | {"total_steps": 32 * iterations, "learning_rate_decay": False, "average": 0.5} | ppo
    depth = dataclasses.replace(EnvConfig().observation.depth, enabled=False)
    env = EnvConfig(horizon=HORIZON, observation=dataclasses.replace(EnvConfig().observation, depth=depth))
    network = NetworkConfig(state_only_hidden=(8, 8))
    return Config(policy="state-only", seed=3, env=env, network=network, ppo=PPOConfig(**values))


def mesh() -> Mesh:
    return make_mesh()


def tiny_trainer(config: Config) -> Trainer:
    """A trainer, the same one for runs that differ in length alone, so that it compiles once."""
    assert not config.ppo.learning_rate_decay  # which would make the program depend on the length
    return _trainer(dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, total_steps=1)))


@cache
def _trainer(config: Config) -> Trainer:
    return Trainer(config, TinyEnv(), mesh())


def tiny_seeds(config: Config, seeds: tuple[int, ...]) -> SeedsTrainer:
    """The learner of several seeds; as above, one for runs that differ in length alone."""
    return _seeds(tiny_trainer(dataclasses.replace(config, seed=0)), seeds)


@cache
def _seeds(trainer: Trainer, seeds: tuple[int, ...]) -> SeedsTrainer:
    return SeedsTrainer(trainer, seeds)


class Interrupted:
    """A learner that does something before its nth iteration."""

    def __init__(self, learner: Any, iteration: int, action: Any) -> None:
        self.learner, self.left, self.action = learner, iteration, action

    def __getattr__(self, name: str) -> Any:
        return getattr(self.learner, name)

    def iterate(self, state: Any, pool: Any) -> Any:
        self.left -= 1
        if self.left == 0:
            self.action()
        return self.learner.iterate(state, pool)


class Wordy:
    """A learner with metrics of long names: their events are longer than anything else that a tiny run writes."""

    def __init__(self, learner: Any, count: int = 40) -> None:
        self._learner, self._more = learner, {f"{'filler' * 40}/{i}": 0.0 for i in range(count)}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def iterate(self, state: Any, pool: Any) -> Any:
        state, metrics = self._learner.iterate(state, pool)
        return state, metrics | self._more


@contextlib.contextmanager
def file_limit(size: int) -> Iterator[None]:
    """Within, no file grows beyond so many bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
