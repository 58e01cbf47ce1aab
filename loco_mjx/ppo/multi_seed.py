"""Several seeds of one configuration as one program: a training step over a leading axis of seeds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.ppo.rollout import Metrics
from loco_mjx.ppo.trainer import Trainer, TrainState
from loco_mjx.sharding import AXIS


class SeedsTrainer:
    """A :class:`Trainer`'s program for S seeds at once; nothing of one seed reaches another.

    Every array of the state, the pool and the metrics has a leading axis of S; each seed's environments are sharded
    over the trainer's mesh as a single seed's are. Seed i draws the same numbers as its own single run: initial
    parameters, scenes, starts, the noise of its actions, the order of its samples. Batched matrix products may round
    differently, which a run of thousands of chaotic steps amplifies: its curve is another sample of the same
    distribution.

    Attributes:
        trainer: of a single seed; its configuration's own seed is not used.
        seeds: in the order of the leading axis.
        iterate: (state, pool) -> (next state, dict of (S,) arrays), compiled once; donates the state.
        split: state -> list of each seed's :class:`TrainState`, as :attr:`trainer` has it.
        join: the inverse of `split`.
    """

    def __init__(self, trainer: Trainer, seeds: Sequence[int]) -> None:
        """Prepares the programs; nothing is compiled yet."""
        self.trainer, self.seeds = trainer, list(seeds)
        mesh, is_spec = trainer.mesh, lambda x: isinstance(x, P)
        state = jax.tree.map(lambda spec: P(None, *spec), trainer.partition_specs, is_leaf=is_spec)
        replicated = P()
        place = partial(jax.tree.map, partial(NamedSharding, mesh), is_leaf=is_spec)
        self.iterate = jax.jit(
            trainer.shard_map(self._each_step, (state, replicated), (state, replicated)), donate_argnums=0
        )
        self._start = jax.jit(trainer.shard_map(self._each_start, (replicated, replicated), state))
        self._make_pool = jax.jit(jax.vmap(trainer.pool, (0, None)), out_shardings=NamedSharding(mesh, replicated))
        self.split = jax.jit(self._split, out_shardings=[place(trainer.partition_specs)] * len(self.seeds))
        self.join = jax.jit(self._join, out_shardings=place(state))

    @property
    def _keys(self) -> jax.Array:
        return jp.stack([jax.random.PRNGKey(seed) for seed in self.seeds])

    def init(self) -> TrainState:
        """The state before the first iteration."""
        return self._start(self._keys, self.make_pool(0))

    def make_pool(self, iteration: int) -> Any:
        """Each seed's scenes of an iteration."""
        return self._make_pool(self._keys, self.trainer.pool_number(iteration))

    def _each_step(self, states: TrainState, pools: Any) -> tuple[TrainState, Metrics]:
        """One iteration of every seed.

        A CPU core has no use for larger matrix products than a minibatch's, and none for activations that leave its
        cache: there, seeds collect together and learn in turn.
        """
        learn = partial(self.trainer.update_on_device, axis_name=AXIS)
        states, rollouts, collected = jax.vmap(partial(self.trainer.collect_on_device, axis_name=AXIS))(states, pools)
        if self.trainer.chunk is None:
            states, learnt = jax.vmap(learn)(states, rollouts)
        else:
            states, learnt = jax.lax.map(lambda seed: learn(*seed), (states, rollouts))
        return states, collected | learnt

    def _each_start(self, keys: jax.Array, pools: Any) -> TrainState:
        """Every seed's state before the first iteration, made one after the other.

        The initialisers decompose matrices. On a CPU a batch of decompositions waits for threads of the pool that it
        runs on, and two devices with two threads wait for ever.
        """
        return jax.lax.map(lambda seed: self.trainer.start(seed[0], seed[1], AXIS), (keys, pools))

    def _split(self, state: TrainState) -> list[TrainState]:
        return [jax.tree.map(lambda x, i=i: x[i], state) for i in range(len(self.seeds))]

    def _join(self, parts: Sequence[TrainState]) -> TrainState:
        return jax.tree.map(lambda *leaves: jp.stack(leaves), *parts)
