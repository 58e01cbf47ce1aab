"""The training program: collect and update, one compiled call per iteration, environments sharded over a mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import optax
from flax import struct
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.config import Config
from loco_mjx.env import autoreset
from loco_mjx.env.state import State
from loco_mjx.networks.outputs import Params
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import annealing, checks
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo import rollout as collect_lib
from loco_mjx.ppo import update as update_lib
from loco_mjx.ppo.loss import psum
from loco_mjx.ppo.normalizer import Normalizer
from loco_mjx.ppo.rollout import Metrics, Rollout
from loco_mjx.sharding import AXIS, make_mesh, shard_map

CPU_CHUNK = 32  # samples at once on a CPU device: activations stay in the cache
# What a key is for; folded into the seed's key.
_PARAMS, _ENVS, _POOL, _ACTIONS, _SHUFFLE = range(5)


def _nonfinite(tree: Any) -> jax.Array:
    """() how many numbers of a pytree are NaN or infinite."""
    counts = [jp.sum(~jp.isfinite(leaf)) for leaf in jax.tree.leaves(tree)]
    return jp.asarray(sum(counts), jp.float32)


@struct.dataclass
class TrainState:
    """Everything that training carries from one iteration to the next, and all that a checkpoint needs.

    Attributes:
        params: the networks' parameters.
        opt_state: the optimiser's state.
        normalizer: statistics of `state`.
        env_state: (num_envs, ...) the environments, sharded over the mesh.
        key: (2,) uint32 the seed's key; constant, every draw folds in its purpose and the iteration.
        iteration: () int32 iterations done.
        samples: () int32 environment steps taken.
        teacher: what is imitated, constant; None for plain PPO (see loco_mjx/ppo/distill.py).
        mean: of the parameters over iterations; None where the policy is the last ones.
    """

    params: Params
    opt_state: optax.OptState
    normalizer: Normalizer
    env_state: State
    key: jax.Array
    iteration: jax.Array
    samples: jax.Array
    teacher: Any = None
    mean: Params | None = None

    @property
    def policy(self) -> Params:
        """Parameters of the policy that is evaluated and kept; `params` explore and learn."""
        return self.params if self.mean is None else self.mean


class Trainer:
    """PPO on a batch of environments.

    The mesh has one axis, ``env``: each device holds some of the environments, collects from them, and adds their
    transitions to every minibatch's gradient.

    Attributes:
        partition_specs: of a state: a TrainState of PartitionSpecs.
        iterate: (state, pool) -> (next state, dict of scalars), one iteration on all devices, compiled once. It
            donates the state: what was passed in cannot be used again.
        collect: (state, pool) -> (state, Rollout, dict of scalars), the first half of `iterate`, to be timed apart.
        update: (state, Rollout) -> (state, dict of scalars), the second half.
        draw_pool: (a seed's key, pool number) -> the pool, compiled once.
    """

    def __init__(self, config: Config, env: autoreset.ResettableEnv, mesh: Mesh | None = None) -> None:
        """Prepares the programs; nothing is compiled yet.

        Args:
            config: the run's configuration.
            env: one environment that matches it.
            mesh: devices with one axis named ``env``; by default the first device.

        Raises:
            UnknownNameError: if there is no policy of that name.
            UserError: if sizes do not divide over the mesh, or the policy needs depth that the environment lacks.
        """
        self.mesh = make_mesh(jax.devices()[:1]) if mesh is None else mesh
        self.config, self.env = config, env
        self.networks = make_networks(config.policy, config.network, env.action_size)
        checks.check(config, self.networks, env.observation_size, self.mesh.size)
        self.chunk = CPU_CHUNK if self.mesh.devices.flat[0].platform == "cpu" else None
        # Of a state the environments alone are sharded, on their first axis; a rollout on its second.
        sharded, rollouts, replicated = P(AXIS), P(None, AXIS), P()
        specs: dict[str, Any] = {field.name: replicated for field in dataclasses.fields(TrainState)}
        self.partition_specs = state = TrainState(**specs | {"env_state": sharded})
        step, start = partial(self.step, axis_name=AXIS), partial(self.start, axis_name=AXIS)
        collect, update = (partial(part, axis_name=AXIS) for part in (self.collect_on_device, self.update_on_device))
        self.iterate = jax.jit(self.shard_map(step, (state, replicated), (state, replicated)), donate_argnums=0)
        self.collect = jax.jit(self.shard_map(collect, (state, replicated), (state, rollouts, replicated)))
        self.update = jax.jit(self.shard_map(update, (state, rollouts), (state, replicated)))
        self._init = jax.jit(self.shard_map(start, (replicated, replicated), state))
        self.draw_pool = jax.jit(self.pool, out_shardings=NamedSharding(self.mesh, replicated))

    def shard_map(self, part: Callable, in_specs: Any, out_specs: Any) -> Callable:
        """A function of one device's data, run on all devices of the mesh."""
        return shard_map(part, self.mesh, in_specs, out_specs)

    # Called from outside -------------------------------------------------------------------------------------------

    def init(self) -> TrainState:
        """The state before the first iteration; depends on the seed alone."""
        return self._init(jax.random.PRNGKey(self.config.seed), self.make_pool(0))

    def make_pool(self, iteration: int) -> Any:
        """The scenes of an iteration; they depend on the seed and ``iteration // pool_refresh`` alone."""
        return self.draw_pool(jax.random.PRNGKey(self.config.seed), self.pool_number(iteration))

    def pool_number(self, iteration: int) -> jax.Array:
        """() int32: which of the seed's pools an iteration resets into."""
        return jp.asarray(iteration // self.config.ppo.pool_refresh, jp.int32)

    def pool(self, key: jax.Array, draw: jax.Array) -> Any:
        """The pool of a number, from the seed's key."""
        return self.env.make_pool(jax.random.fold_in(jax.random.fold_in(key, _POOL), draw), self.config.ppo.pool_size)

    # What runs on one device; without an axis name, plain functions to vmap over seeds --------------------------------

    def start(self, key: jax.Array, pool: Any, axis_name: str | None = None) -> TrainState:
        """The state before the first iteration.

        Args:
            key: (2,) uint32 the seed's key.
            pool: scenes to start in.
            axis_name: the mesh axis whose devices learn together, or None.
        """
        keys = self._env_keys(jax.random.fold_in(key, _ENVS), axis_name)
        env_state = jax.vmap(lambda env_key: autoreset.first(self.env, env_key, pool))(keys)
        sizes = self.env.observation_size
        blank = {name: jp.zeros((1, *shape)) for name, shape in sizes.items()}
        params = self.networks.init(jax.random.fold_in(key, _PARAMS), blank)
        state = TrainState(
            params=params,
            opt_state=update_lib.make_optimizer(self.config.ppo).init(params),
            normalizer=normalizer_lib.create(sizes["state"][0]),
            env_state=env_state,
            key=key,
            iteration=jp.zeros((), jp.int32),
            samples=jp.zeros((), jp.int32),
            mean=params if self.config.ppo.average else None,
        )
        return jax.tree.map(_strongly_typed, state)

    def step(self, state: TrainState, pool: Any, axis_name: str | None = None) -> tuple[TrainState, Metrics]:
        """One iteration: the next state and a dict of scalars."""
        state, rollout, collected = self.collect_on_device(state, pool, axis_name)
        state, learnt = self.update_on_device(state, rollout, axis_name)
        return state, collected | learnt

    def _env_keys(self, key: jax.Array, axis_name: str | None) -> jax.Array:
        """One key per environment of this device; which one an environment gets does not depend on the devices."""
        shards = 1 if axis_name is None else self.mesh.size
        count = self.config.ppo.num_envs // shards
        first = 0 if axis_name is None else jax.lax.axis_index(axis_name) * count
        return jax.vmap(jax.random.fold_in, (None, 0))(key, first + jp.arange(count))

    def collect_on_device(
        self, state: TrainState, pool: Any, axis_name: str | None = None
    ) -> tuple[TrainState, Rollout, Metrics]:
        """The first half of an iteration: only the environments' states change."""
        purpose = jax.random.fold_in(jax.random.fold_in(state.key, _ACTIONS), state.iteration)
        keys = self._env_keys(purpose, axis_name)
        env_state, rollout, sums = collect_lib.collect(
            self.env,
            self.networks,
            state.params,
            state.normalizer,
            state.env_state,
            pool,
            keys,
            self.config.ppo.unroll,
        )
        metrics = collect_lib.averages(psum(sums, axis_name))
        return dataclasses.replace(state, env_state=jax.tree.map(_strongly_typed, env_state)), rollout, metrics

    def update_on_device(
        self, state: TrainState, rollout: Rollout, axis_name: str | None = None, learn: Callable | None = None
    ) -> tuple[TrainState, Metrics]:
        """The second half: learning from the rollout (by `learn` in place of PPO), then the normaliser's statistics."""
        ppo = self.config.ppo
        shuffle_key = jax.random.fold_in(jax.random.fold_in(state.key, _SHUFFLE), state.iteration)
        if axis_name is not None:
            shuffle_key = jax.random.fold_in(shuffle_key, jax.lax.axis_index(axis_name))
        data = update_lib.experience(rollout, state.normalizer, ppo, self.networks.hold)
        (params, opt_state), metrics = (learn or self.learn)(state, data, shuffle_key, axis_name)
        # The statistics change only now: the update above needs those the rollout was collected with.
        normalizer = normalizer_lib.update(state.normalizer, rollout.state[:-1], rollout.weight, axis_name)
        state = dataclasses.replace(
            state,
            params=params,
            mean=annealing.averaged(state.mean, params, ppo, state.iteration),
            opt_state=opt_state,
            normalizer=normalizer,
            iteration=state.iteration + 1,
            samples=state.samples + ppo.samples_per_iteration,
        )
        kept = {"parameters": state.params, "optimizer": state.opt_state, "normalizer": state.normalizer}
        return state, metrics | {f"nonfinite/{name}": _nonfinite(tree) for name, tree in kept.items()}

    def learn(
        self, state: TrainState, data: update_lib.Experience, key: jax.Array, axis_name: str | None
    ) -> tuple[tuple[Params, optax.OptState], Metrics]:
        """New parameters and optimiser's state from this device's experience, and a dict of scalars."""
        ppo = self.config.ppo
        rate = annealing.learning_rate(ppo, state.iteration)
        learner = (state.params, state.opt_state)
        learner, metrics = update_lib.update(self.networks, ppo, learner, data, key, rate, axis_name, self.chunk)
        params = annealing.narrowed(learner[0], ppo, self.config.network.initial_std, state.iteration)
        return (params, learner[1]), metrics | {"learning_rate": rate}


def _strongly_typed(x: jax.Array) -> jax.Array:
    """The array with its dtype fixed: a weakly typed leaf would make the second iteration compile again."""
    return jax.lax.convert_element_type(x, x.dtype) if x.weak_type else x
