"""Method `distill`: the policy acts, a privileged teacher says what it would have done (DAgger), then PPO goes on.

Ross et al. 2011. The teacher is a blind MLP that also reads what only a simulator knows; it learns by PPO in a fraction
of the time that a policy takes from pixels. What limits a policy that imitates is what it can see: PPO takes it from
there, with the teacher's value function as its first critic.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import optax
from flax import struct
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from loco_mjx.config import Config
from loco_mjx.env import autoreset
from loco_mjx.networks.outputs import PRIVILEGED, STATE, Params
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import loss as loss_lib
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo import update as update_lib
from loco_mjx.ppo.normalizer import Normalizer
from loco_mjx.ppo.rollout import Metrics
from loco_mjx.ppo.trainer import Trainer, TrainState
from loco_mjx.sharding import AXIS

TEACHER = "privileged"  # the policy that teaches


@struct.dataclass
class Teacher:
    """A trained teacher.

    Attributes:
        params: of the policy TEACHER.
        normalizer: statistics of its `state`.
    """

    params: Params
    normalizer: Normalizer


class DistillTrainer(Trainer):
    """A :class:`Trainer` whose first iterations imitate; those after them are PPO's.

    The policy starts with the teacher's normaliser, its critic with the teacher's value function. The program of each
    phase is compiled when the phase begins.
    """

    def __init__(
        self, config: Config, env: autoreset.ResettableEnv, teacher: Teacher, mesh: Mesh | None = None
    ) -> None:
        """Prepares the programs; the arguments, and what is raised, are Trainer's.

        Args:
            config: of the run, of method `distill`.
            env: one environment that matches it.
            teacher: to be imitated; its networks are of the same sizes.
            mesh: devices with one axis named ``env``.
        """
        super().__init__(config, env, mesh)
        # NumPy's arrays have no weak types, for which the first iteration would be a program of its own.
        self.teacher = jax.device_get(teacher)
        self.teacher_networks = make_networks(
            TEACHER, dataclasses.replace(config.network, critic="shared"), env.action_size
        )
        self.imitation_config = dataclasses.replace(
            config.ppo,
            learning_rate=config.distill.learning_rate,
            minibatch=config.distill.minibatch,
            epochs=config.distill.epochs,
            learning_rate_decay=False,
        )
        state, replicated = self.partition_specs, P()
        step = partial(self.imitation_step, axis_name=AXIS)
        self._improve: Callable = self.iterate
        self._imitate = jax.jit(self.shard_map(step, (state, replicated), (state, replicated)), donate_argnums=0)
        self.iterate = self._iterate  # type: ignore[assignment]

    @property
    def imitation_iterations(self) -> int:
        """Iterations in which the policy imitates."""
        return round(self.config.distill.imitation * self.config.ppo.iterations)

    def _iterate(self, state: TrainState, pool: Any) -> tuple[TrainState, Metrics]:
        iteration = int(state.iteration)
        if iteration < self.imitation_iterations:
            return self._imitate(state, pool)
        if iteration == self.imitation_iterations:
            # Adam begins anew: its moments are of the gradients of another loss.
            state = dataclasses.replace(state, opt_state=jax.tree.map(jp.zeros_like, state.opt_state))
        return self._improve(state, pool)

    def start(self, key: jax.Array, pool: Any, axis_name: str | None = None) -> TrainState:
        """The state before the first iteration, as Trainer's but for what the teacher gives."""
        state = super().start(key, pool, axis_name)
        taught = self.teacher.params["params"]
        critic = {name: taught[name] for name in ("state_encoder", "value_head")}
        params = {"params": state.params["params"] | {"critic": critic}}
        return dataclasses.replace(
            state,
            params=params,
            mean=None if state.mean is None else params,
            normalizer=self.teacher.normalizer,
            teacher=self.teacher,
        )

    def imitation_step(self, state: TrainState, pool: Any, axis_name: str | None = None) -> tuple[TrainState, Metrics]:
        """One iteration of imitation: the next state and a dict of scalars."""
        state, rollout, collected = self.collect_on_device(state, pool, axis_name)
        state, learned = self.update_on_device(state, rollout, axis_name, learn=self.imitate)
        return state, collected | learned

    def imitate(
        self, state: TrainState, data: update_lib.Experience, key: jax.Array, axis_name: str | None
    ) -> tuple[tuple[Params, optax.OptState], Metrics]:
        """As Trainer.learn, from what the teacher would have done."""
        config = self.imitation_config
        data = dataclasses.replace(
            data, teacher_action=self.teacher_actions(state.teacher, data.rollout.state, data.rollout.privileged)
        )
        rate = self.imitation_rate(state.iteration)
        learner = (state.params, state.opt_state)
        learner, metrics = update_lib.update(
            self.networks, config, learner, data, key, rate, axis_name, self.chunk, loss_lib.imitation
        )
        return learner, metrics | {"learning_rate": rate}

    def imitation_rate(self, iteration: jax.Array) -> jax.Array:
        """() learning rate of an iteration of imitation: constant, or falling linearly to 0 at the last one's end."""
        rate = jp.asarray(self.imitation_config.learning_rate, jp.float32)
        if not self.config.distill.learning_rate_decay:
            return rate
        return rate * jp.maximum(1.0 - iteration.astype(jp.float32) / max(self.imitation_iterations, 1), 0.0)

    def teacher_actions(self, teacher: Teacher, state: jax.Array, privileged: jax.Array | None) -> jax.Array:
        """(T, B, actions) the teacher's mean actions at (T+1, B, ...) observations but the last, in [−1, 1]."""
        assert privileged is not None
        obs = {STATE: normalizer_lib.normalize(teacher.normalizer, state[:-1]), PRIVILEGED: privileged[:-1]}
        return jax.lax.stop_gradient(jp.tanh(self.teacher_networks.apply(teacher.params, obs).mean))
