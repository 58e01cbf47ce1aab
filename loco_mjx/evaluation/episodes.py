"""Runs a policy for whole episodes, each in a newly generated scene, and reports what happened in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from flax import struct
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.config import EnvConfig
from loco_mjx.env.state import State
from loco_mjx.errors import UserError
from loco_mjx.evaluation.display import PER_METRE
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo.actor import Actor, Held
from loco_mjx.sharding import AXIS, shard_map

CHUNK = 64  # episodes run side by side on a CPU; an accelerator takes more
ACCELERATOR_CHUNK = 1024
EARLY_SECONDS = 16.0  # 1,000 steps of the authors' code; the paper prints 25 Hz, its code runs at 62.5 Hz
EARLY = {"distance": "distance_16s", "collisions": "collisions_16s"}  # metrics that are also summed over that time
WALKED = 1.0  # m, mean distance below which collisions per metre say nothing
Figures = dict[str, np.ndarray]
_Carry = tuple[State, "Tally", Held]


def evaluation_config(config: EnvConfig, task: str | None = None, randomize: bool = False) -> EnvConfig:
    """The environment a policy is evaluated in: its own, on any task, with randomisation off unless asked for.

    Args:
        config: the environment it was trained in.
        task: to evaluate on; None: the one it was trained on.
        randomize: draw dynamics, latency and blind pixels as in training with randomisation.
    """
    observation = config.observation
    depth = dataclasses.replace(observation.depth, noise=None)
    return dataclasses.replace(
        config,
        task=config.task if task is None else task,
        observation=dataclasses.replace(observation, depth=depth),
        randomization=dataclasses.replace(config.randomization, enabled=randomize),
    )


def keys_of(seed: int, episode: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Keys of a seed's episode: of its start, and of the actions where they are drawn. Its number alone decides."""
    start, actions = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(seed), episode))
    return start, actions


@struct.dataclass
class Tally:
    """Sums of metrics over episodes that run side by side, each until its first `done`.

    Attributes:
        sums: (episodes,) of each metric, and of `return`, `length` and `survived`.
        alive: (episodes,) bool, which episodes go on.
        step: () int32 control steps taken.
        early: how many of them are within EARLY_SECONDS.
    """

    sums: dict[str, jax.Array]
    alive: jax.Array
    step: jax.Array
    early: int = struct.field(pytree_node=False)

    @classmethod
    def start(cls, state: State, control_dt: float) -> Tally:
        """Nothing has happened yet; `state` is the episodes' first, and a control step lasts `control_dt` seconds."""
        zero = jp.zeros(state.done.shape, jp.float32)
        early = [metric for name, metric in EARLY.items() if name in state.metrics]
        sums = dict.fromkeys((*state.metrics, *early, "return", "length", "survived"), zero)
        steps = round(EARLY_SECONDS / control_dt)
        return cls(sums, jp.ones(zero.shape, bool), jp.zeros((), jp.int32), steps)

    def add(self, state: State) -> Tally:
        """Counts a control step, after which the episodes are in `state`."""
        survived = state.done * state.info["truncation"]
        values = state.metrics | {"return": state.reward, "length": jp.ones_like(state.reward), "survived": survived}
        early = {metric: name for name, metric in EARLY.items() if metric in self.sums}
        values |= {metric: jp.where(self.step < self.early, values[name], 0.0) for metric, name in early.items()}
        sums = {name: total + jp.where(self.alive, values[name], 0.0) for name, total in self.sums.items()}
        return Tally(sums, self.alive & (state.done == 0), self.step + 1, self.early)


class Evaluator:
    """Episodes of one environment, side by side, sharded over the mesh; compiled once per number of episodes."""

    def __init__(self, env: Any, networks: Networks, horizon: int, mesh: Mesh, deterministic: bool = True) -> None:
        """Prepares the program.

        Args:
            env: a :class:`loco_mjx.env.loco_env.LocoEnv`, or anything with its `reset`, `step` and `dt`.
            networks: of the policy.
            horizon: the longest an episode can be, control steps.
            mesh: devices with one axis named ``env``.
            deterministic: act by the mean of the policy's Gaussian.
        """
        self.env, self.networks, self.horizon, self.mesh = env, networks, horizon, mesh
        self.deterministic = deterministic
        self._run = jax.jit(shard_map(self._on_device, mesh, (P(), P(), P()), P()))

    def run(self, params: Any, normalizer: Any, seed: int, episodes: int) -> Figures:
        """Each metric of each episode, (episodes,); episode i is the same whatever their number.

        Args:
            params: of the networks.
            normalizer: statistics of the policy's input.
            seed: of the scenes, the starts and, where the policy is stochastic, its actions.
            episodes: how many.

        Raises:
            UserError: if there are none to run.
        """
        if episodes < 1:
            raise UserError(f"episodes is {episodes}; accepted: 1 or more")
        devices = self.mesh.size
        limit = CHUNK if self.mesh.devices.flat[0].platform == "cpu" else ACCELERATOR_CHUNK
        chunk = min(limit, episodes)
        chunk = -(-chunk // devices) * devices  # a multiple of the devices; what is too many is run and dropped
        total = -(-episodes // chunk) * chunk
        params, normalizer = jax.device_put((params, normalizer), NamedSharding(self.mesh, P()))
        keys = jax.vmap(partial(keys_of, seed))(jp.arange(total))
        parts = [
            self._run(params, normalizer, jax.tree.map(lambda key, first=first: key[first : first + chunk], keys))
            for first in range(0, total, chunk)
        ]
        sums = {name: np.concatenate([np.asarray(part[name]) for part in parts])[:episodes] for name in parts[0]}
        return figures(sums)

    def _on_device(self, params: Any, normalizer: Any, keys: Any) -> dict[str, jax.Array]:
        """All episodes, of which each device runs as many; every device has the whole result."""
        device = jax.lax.axis_index(AXIS)
        own = jax.tree.map(lambda key: key.reshape(self.mesh.size, -1, *key.shape[1:])[device], keys)
        return jax.lax.all_gather(self._episodes(params, normalizer, *own), AXIS, tiled=True)

    def _episodes(self, params: Any, normalizer: Any, start: jax.Array, actions: jax.Array) -> dict[str, jax.Array]:
        """One device's episodes, from (episodes, ...) keys: sums of metrics until each one's first `done`."""
        actor = Actor(self.networks, params, normalizer, self.deterministic)
        state = jax.vmap(self.env.reset)(start)

        def more(carry: _Carry) -> jax.Array:
            return jp.any(carry[1].alive) & (carry[1].step < self.horizon)

        def body(carry: _Carry) -> _Carry:
            state, tally, held = carry
            # One key per environment, so that an episode does not depend on which others run beside it.
            keys = jax.vmap(jax.random.fold_in, (0, None))(actions, tally.step)
            action, held = jax.vmap(actor.act, (0, 0, None, 0))(state.obs, held, tally.step, keys)
            state = jax.vmap(self.env.step)(state, action)
            return state, tally.add(state), held

        carry = (state, Tally.start(state, self.env.dt), actor.start(state.obs))
        return jax.lax.while_loop(more, body, carry)[1].sums


def figures(sums: Mapping[str, np.ndarray]) -> Figures:
    """Sums over an episode's steps to its metrics: all are sums but the speed, which is a mean.

    `reached_goal` is 1 for an episode in which the robot was at the goal for a control step or more.
    """
    found = {name: np.asarray(value, np.float64) for name, value in sums.items()}
    if "speed" in found:
        found["speed"] = found["speed"] / np.maximum(found["length"], 1.0)
    if "at_goal" in found:
        found["reached_goal"] = (found["at_goal"] > 0).astype(np.float64)
    return found


def means(figures: Figures) -> dict[str, float]:
    """The mean of each metric over the episodes, and collisions per metre where the robot walked."""
    return {name: found["mean"] for name, found in summarize(figures).items()}


def summarize(figures: Figures) -> dict[str, dict[str, float]]:
    """Mean and standard deviation of each metric over the episodes, and collisions per metre where the robot walked."""
    found = {name: {"mean": float(np.mean(v)), "std": float(np.std(v))} for name, v in figures.items()}
    return found | _per_metre(figures)


def _per_metre(figures: Figures) -> dict[str, dict[str, float]]:
    """All collisions over all metres; a mean of the episodes' ratios would be ruined by one robot that stands still.

    Its deviation is that of (collisions − ratio · distance) / mean distance over the episodes.
    """
    if not {"collisions", "distance"} <= set(figures) or np.mean(figures["distance"]) < WALKED:
        return {}
    metres = float(np.mean(figures["distance"]))
    ratio = float(np.mean(figures["collisions"])) / metres
    return {
        PER_METRE: {"mean": ratio, "std": float(np.std(figures["collisions"] - ratio * figures["distance"])) / metres}
    }
