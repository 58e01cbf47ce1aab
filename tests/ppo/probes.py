"""Probe environments: each can only be solved if one part of PPO works. They follow LocoEnv's protocol."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jp

from loco_mjx.config import Config, NetworkConfig, PPOConfig
from loco_mjx.env.state import State
from loco_mjx.networks.outputs import DEPTH


@dataclass(frozen=True)
class Probe:
    """Base: `state` is (2,), a sign drawn at every step and the phase of the episode; the reward is 1.

    An episode lasts `horizon` steps; it then terminates, or is truncated with `truncates`.
    """

    horizon: int = 4
    truncates: bool = False
    depth: bool = False
    size: int = 64  # of the depth image
    action_size: int = 1
    dt: float = 0.04  # s
    start_spread: int = 0  # an episode's first step is drawn from 0..start_spread

    @property
    def observation_size(self):
        return {"state": (2,)} | ({DEPTH: (self.size, self.size, 4)} if self.depth else {})

    def make_pool(self, key, size):
        return jax.random.uniform(key, (size,))  # scene = +U(0, 1): the brightness of its depth images

    def draw(self, key, pool):
        return pool[jax.random.randint(key, (), 0, pool.shape[0])]

    def reset_to(self, key, scene):
        sign_key, spread_key, key = jax.random.split(key, 3)
        world = {
            "sign": _sign(sign_key),
            "step": jax.random.randint(spread_key, (), 0, self.start_spread + 1),
            "scene": scene,
        }
        obs = {name: jp.zeros(shape) for name, shape in self.observation_size.items()}
        info = {"truncation": jp.zeros(()), "key": key, "first": jp.ones(())}
        return State(world, obs, jp.zeros(()), jp.zeros(()), {"seen": jp.zeros(())}, info)

    def advance(self, state, action):
        sign_key, key = jax.random.split(state.info["key"])
        world = dict(state.pipeline_state)
        reward = self.reward(world, action)
        world["step"] = world["step"] + 1
        world["sign"] = self.next_sign(world["sign"], sign_key)
        done = (world["step"] >= self.horizon).astype(jp.float32)
        info = dict(state.info) | {"truncation": done * float(self.truncates), "key": key, "first": jp.zeros(())}
        return state.replace(pipeline_state=world, reward=reward, done=done, metrics={"seen": world["sign"]}, info=info)

    def observe(self, state):
        world = state.pipeline_state
        obs = {"state": self.state_vector(world)}
        if self.depth:
            frame, old = self.frame(world, state), state.obs[DEPTH]
            pushed = jp.concatenate([frame[..., None], old[..., :-1]], axis=-1)
            obs[DEPTH] = jp.where(state.info["first"] > 0, jp.repeat(frame[..., None], 4, -1), pushed)
        return state.replace(obs=obs)

    def reward(self, world, action):
        return jp.ones(())

    def next_sign(self, sign, key):
        return _sign(key)

    def state_vector(self, world):
        return jp.stack([world["sign"], world["step"] / self.horizon])

    def frame(self, world, state):
        """The sign in the left half of the image, in the right half what tells scenes and steps apart."""
        left = jp.arange(self.size) < self.size // 2
        return jp.where(left, world["sign"], 0.1 * (world["scene"] + world["step"])) * jp.ones((self.size, 1))


@dataclass(frozen=True)
class EndingProbe(Probe):
    """Reward 1 at each of two steps; an episode whose sign is + is then truncated, the others terminate.

    The phase of those that are truncated is hidden: at a time limit the last observation looks like any other.
    """

    horizon: int = 2

    def next_sign(self, sign, key):
        return sign

    def advance(self, state, action):
        after = super().advance(state, action)
        truncation = after.done * (after.pipeline_state["sign"] > 0)
        return after.replace(info=after.info | {"truncation": truncation})

    def state_vector(self, world):
        return jp.stack([world["sign"], jp.where(world["sign"] > 0, 0.0, world["step"] / self.horizon)])


@dataclass(frozen=True)
class SignProbe(Probe):
    """The reward is the action times the sign that is seen: policies must read the observation."""

    def reward(self, world, action):
        return action[0] * world["sign"]


@dataclass(frozen=True)
class DepthSignProbe(SignProbe):
    """The sign is seen in the depth image only."""

    depth: bool = True

    def state_vector(self, world):
        return jp.stack([0.0 * world["sign"], world["step"] / self.horizon])


@dataclass(frozen=True)
class DelayedProbe(Probe):
    """The last step of the episode is rewarded with the first step's action; the state carries it."""

    horizon: int = 3

    def reward(self, world, action):
        return jp.where(world["step"] >= self.horizon - 1, world["memory"], 0.0)

    def reset_to(self, key, scene):
        state = super().reset_to(key, scene)
        return state.replace(pipeline_state=state.pipeline_state | {"memory": jp.zeros(())})

    def advance(self, state, action):
        world = dict(state.pipeline_state)
        world["memory"] = jp.where(world["step"] == 0, action[0], world["memory"])
        return super().advance(state.replace(pipeline_state=world), action)

    def state_vector(self, world):
        return jp.stack([world["memory"], world["step"] / self.horizon])


@dataclass(frozen=True)
class BrokenProbe(SignProbe):
    """Every third step yields a reward and a state that are not finite."""

    def _broken(self, world):
        return world["step"] % 3 == 2

    def reward(self, world, action):
        return jp.where(self._broken(world), jp.nan, super().reward(world, action))

    def state_vector(self, world):
        return jp.where(self._broken(world), jp.array([jp.inf, jp.nan]), super().state_vector(world))


def _sign(key):
    return jp.where(jax.random.bernoulli(key), 1.0, -1.0)  # sign = ±1, even odds


def tiny(policy="state-only", **ppo):
    """A configuration for probes: small networks, few environments."""
    network = NetworkConfig(token_dim=16, mlp_dim=32, layers=1, hidden=(32, 32), state_only_hidden=(32, 32, 32, 32))
    base = PPOConfig(num_envs=16, unroll=8, minibatch=32, epochs=4, learning_rate=3e-3, learning_rate_decay=False)
    base = dataclasses.replace(base, total_steps=100_000, pool_size=8, entropy=0.0, discount=0.9)
    return dataclasses.replace(Config(policy=policy), network=network, ppo=dataclasses.replace(base, **ppo))
