"""Learning from a rollout: epochs of minibatches, one gradient step of Adam each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import optax
from flax import struct

from loco_mjx.config import PPOConfig
from loco_mjx.networks.outputs import DEPTH, PRIVILEGED, STATE, Outputs, Params
from loco_mjx.networks.policies import Networks
from loco_mjx.ppo import frame_stack, gae
from loco_mjx.ppo import loss as loss_lib
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.actor import held_since
from loco_mjx.ppo.loss import Minibatch, masked_mean, psum
from loco_mjx.ppo.normalizer import Normalizer
from loco_mjx.ppo.rollout import Metrics, Rollout

LearnerState = tuple[Params, optax.OptState]
# From the networks' outputs, transitions, normalised advantages, the whole minibatch's weight and the coefficients to
# what these transitions add to each loss that an optimiser minimises, and to the terms that are reported.
Objective = Callable[[Outputs, Minibatch, jax.Array, jax.Array, PPOConfig], tuple[dict[str, jax.Array], Metrics]]


@struct.dataclass
class Experience:
    """A rollout with what is computed from it once. Transition t of environment b has the index t · B + b.

    Attributes:
        rollout: T steps of B environments.
        normalizer: the statistics it was collected with.
        advantage: (T, B) λ-advantages.
        starts: (T+1, B) from :func:`loco_mjx.ppo.frame_stack.episode_starts`, or None without depth.
        teacher_action: (T, B, actions) what a teacher would have done, in [−1, 1], or None without one.
        hold: control steps for which the policy held the depth it saw (static).
    """

    rollout: Rollout
    normalizer: Normalizer
    advantage: jax.Array
    starts: jax.Array | None
    teacher_action: jax.Array | None = None
    hold: int = struct.field(pytree_node=False, default=1)

    def minibatch(self, indices: jax.Array) -> Minibatch:
        """The transitions of (n,) int32 indices."""
        at = jp.divmod(indices, self.rollout.reward.shape[1])
        data = self.rollout
        taught = None if self.teacher_action is None else self.teacher_action[at]
        return Minibatch(
            data.action[at], data.log_prob[at], data.value[at], self.advantage[at], data.weight[at], taught
        )

    def observation(self, indices: jax.Array) -> dict[str, jax.Array]:
        """(n, ...) policy inputs of (n,) int32 indices, equal to those the policy acted on."""
        step, column = jp.divmod(indices, self.rollout.reward.shape[1])
        obs = {STATE: normalizer_lib.normalize(self.normalizer, self.rollout.state[step, column])}
        stored = self.rollout.frames
        if stored is not None and self.starts is not None:
            count = stored.shape[0] - self.rollout.reward.shape[0]
            acted_on = held_since(step, self.starts[step, column], self.hold)
            obs[DEPTH] = frame_stack.stack(stored, self.starts, acted_on, column, count)
        if self.rollout.privileged is not None:
            obs[PRIVILEGED] = self.rollout.privileged[step, column]
        return obs


def experience(rollout: Rollout, normalizer: Normalizer, config: PPOConfig, hold: int = 1) -> Experience:
    """Computes advantages and episode starts of a rollout whose policy held its depth for `hold` control steps."""
    data, reward = rollout, config.reward_scale * rollout.reward
    advantage = gae.advantages(
        reward, data.value, data.terminated, data.done, data.reset, config.discount, config.gae_lambda
    )
    starts = None
    if data.frames is not None:
        starts = frame_stack.episode_starts(data.reset, data.frames.shape[0] - data.reward.shape[0])
    return Experience(rollout, normalizer, advantage, starts, hold=hold)


def make_optimizer(config: PPOConfig) -> optax.GradientTransformation:
    """Clips the gradient's global norm, then Adam without its learning rate (which :func:`apply_gradients` applies).

    `separate` optimisers take two gradients, of the losses `policy` and `value`; each is clipped by itself and
    has an Adam of its own, and both move what policy and value share, as in the authors' code (there one
    after the other). With one clip the value's gradient, several times as large, shrinks the policy's steps.
    """
    each = optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.scale_by_adam(eps=1e-5))
    if config.optimizer == "joint":
        return each

    def init(params: Params) -> optax.OptState:
        return {"policy": each.init(params), "value": each.init(params)}

    def step(grads: Any, state: Any, params: Params | None = None) -> tuple[Params, optax.OptState]:
        done = {name: each.update(grads[name], state[name]) for name in state}
        changes = jax.tree.map(jp.add, done["policy"][0], done["value"][0])
        return changes, {name: after for name, (_, after) in done.items()}

    return optax.GradientTransformation(init, step)


def minibatches(key: jax.Array, samples: int, config: PPOConfig) -> jax.Array:
    """(epochs · minibatches, n) int32 shuffled indices: every epoch reads each of this device's transitions once."""
    count = config.samples_per_iteration // config.minibatch
    keys = jax.random.split(key, config.epochs)
    # order ~ uniform over permutations, one per epoch
    orders = jax.vmap(lambda epoch_key: jax.random.permutation(epoch_key, samples))(keys)
    return orders.reshape(config.epochs * count, samples // count).astype(jp.int32)


def chunk_count(samples: int, limit: int | None) -> int:
    """Smallest number of equal chunks of at most `limit` samples each; 1 without a limit."""
    limit = samples if limit is None else limit
    return next(count for count in range(1, samples + 1) if samples % count == 0 and samples // count <= limit)


def gradient(
    networks: Networks,
    config: PPOConfig,
    params: Params,
    data: Experience,
    indices: jax.Array,
    axis_name: str | None = None,
    chunk: int | None = None,
    objective: Objective = loss_lib.loss,
) -> tuple[Any, Metrics]:
    """Gradient of a minibatch's loss, and the loss's terms; the arguments are :func:`update`'s.

    With `separate` optimisers a dict of each one's gradient.
    """
    whole = data.minibatch(indices)
    advantage = loss_lib.normalized_advantage(whole, axis_name)
    total_weight = psum(jp.sum(whole.weight), axis_name)

    def loss(params: Params, indices: jax.Array, advantage: jax.Array, owner: str | None) -> tuple[jax.Array, Metrics]:
        outputs = networks.apply(params, data.observation(indices))
        losses, terms = objective(outputs, data.minibatch(indices), advantage, total_weight, config)
        return sum(losses.values()) if owner is None else losses[owner], terms  # type: ignore[return-value]

    def chunk_gradient(params: Params, indices: jax.Array, advantage: jax.Array) -> tuple[Any, Metrics]:
        if config.optimizer == "joint":
            return jax.grad(partial(loss, owner=None), has_aux=True)(params, indices, advantage)
        # The compiler makes one forward pass of the two, and leaves out what an owner's loss does not depend on.
        each = {name: jax.grad(partial(loss, owner=name), has_aux=True) for name in ("policy", "value")}
        found = {name: grad(params, indices, advantage) for name, grad in each.items()}
        return {name: grads for name, (grads, _) in found.items()}, found["policy"][1]

    chunks = jax.tree.map(lambda x: x.reshape(chunk_count(x.size, chunk), -1), (indices, advantage))
    if chunks[0].shape[0] == 1:
        return psum(chunk_gradient(params, indices, advantage), axis_name)
    shapes = jax.eval_shape(chunk_gradient, params, chunks[0][0], chunks[1][0])
    zeros = jax.tree.map(lambda x: jp.zeros(x.shape, x.dtype), shapes)
    total, _ = jax.lax.scan(
        lambda total, part: (jax.tree.map(jp.add, total, chunk_gradient(params, *part)), None), zeros, chunks
    )
    return psum(total, axis_name)


def apply_gradients(
    config: PPOConfig, learner: LearnerState, grads: Any, rate: jax.Array
) -> tuple[LearnerState, Metrics]:
    """One gradient step; a gradient that is not finite is skipped and counted, and changes nothing."""
    norm = optax.global_norm(grads)
    usable = jp.isfinite(norm)
    directions, opt_state = make_optimizer(config).update(grads, learner[1])
    # θ ← θ − α · Adam(clip(∇L))
    params = jax.tree.map(lambda p, direction: p - rate * direction, learner[0], directions)
    new = jax.tree.map(lambda new, old: jp.where(usable, new, old), (params, opt_state), learner)
    return new, {"grad_norm": norm, "usable": usable.astype(jp.float32)}


def update(
    networks: Networks,
    config: PPOConfig,
    learner: LearnerState,
    data: Experience,
    key: jax.Array,
    rate: jax.Array,
    axis_name: str | None = None,
    chunk: int | None = None,
    objective: Objective = loss_lib.loss,
) -> tuple[LearnerState, Metrics]:
    """All epochs over one rollout.

    On several devices each holds the transitions of its own environments and adds some of them to every minibatch;
    sums over `axis_name` make each gradient that of the whole minibatch.

    Args:
        networks: the policy's networks.
        config: hyper-parameters; sizes are of all devices together.
        learner: parameters, as collected with, and the state of :func:`make_optimizer`'s optimiser.
        data: this device's experience.
        key: this device's, for shuffling.
        rate: () learning rate.
        axis_name: mesh axis of the devices, if any.
        chunk: at most this many samples at once on a device; gradients add up, so that the result is the same but
            for rounding. On a CPU, chunks whose activations fit the cache are faster.
        objective: what to minimise: PPO's loss, or a distillation's.

    Returns:
        New parameters and optimiser state, and metrics; equal on all devices.
    """

    def body(learner: LearnerState, indices: jax.Array) -> tuple[LearnerState, Metrics]:
        grads, terms = gradient(networks, config, learner[0], data, indices, axis_name, chunk, objective)
        learner, step = apply_gradients(config, learner, grads, rate)
        return learner, terms | step

    learner, steps = jax.lax.scan(body, learner, minibatches(key, data.advantage.size, config))
    return learner, _averages(steps) | {"value/explained_variance": explained_variance(data, axis_name)}


def _averages(steps: Metrics) -> Metrics:
    """Means over the minibatches whose gradient was used, NaN where none was, and how many were not."""
    usable = steps.pop("usable")
    any_used = jp.any(usable > 0)
    means = {name: jp.where(any_used, masked_mean(values, usable), jp.nan) for name, values in steps.items()}
    return means | {"skipped_updates": jp.sum(1.0 - usable)}


def explained_variance(data: Experience, axis_name: str | None = None) -> jax.Array:
    """() 1 − Var(target − value) / Var(target) of the values collected with: 1 is perfect, 0 like a constant."""
    weight = data.rollout.weight

    def variance(x: jax.Array) -> jax.Array:
        return masked_mean((x - masked_mean(x, weight, axis_name)) ** 2, weight, axis_name)

    return 1.0 - variance(data.advantage) / jp.maximum(variance(data.advantage + data.rollout.value[:-1]), 1e-8)
