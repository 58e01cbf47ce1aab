"""PPO's loss on a minibatch, with rows of weight 0 for the transitions that span a reset."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import PPOConfig
from loco_mjx.networks.policies import Outputs
from loco_mjx.ppo import distribution


@struct.dataclass
class Batch:
    """Transitions to learn from; leading axis n.

    Attributes:
        action: (n, actions) as drawn, before the tanh.
        log_prob: (n,) of the policy that drew it.
        value: (n,) its value estimate.
        advantage: (n,) λ-advantage.
        weight: (n,) 1, or 0 for a transition that spans a reset.
        label: (n, actions) what a teacher would have done, in [−1, 1], or None without one.
    """

    action: jax.Array
    log_prob: jax.Array
    value: jax.Array
    advantage: jax.Array
    weight: jax.Array
    label: jax.Array | None = None


def psum(x: Any, axis_name: str | None) -> Any:
    """Sum of a pytree over the devices of a mesh axis, if one is named."""
    return x if axis_name is None else jax.lax.psum(x, axis_name)


def masked_mean(x: jax.Array, weight: jax.Array, axis_name: str | None = None) -> jax.Array:
    """Mean of x where weight is 1, over all devices of a mesh axis if one is named."""
    total = psum(jp.sum(jp.where(weight > 0, x, 0.0)), axis_name)
    return total / jp.maximum(psum(jp.sum(weight), axis_name), 1.0)


def normalized_advantage(batch: Batch, axis_name: str | None = None) -> jax.Array:
    """(n,) advantages with mean 0 and standard deviation 1 over the rows that count, of all devices."""
    mean = masked_mean(batch.advantage, batch.weight, axis_name)
    variance = masked_mean((batch.advantage - mean) ** 2, batch.weight, axis_name)
    return jp.where(batch.weight > 0, (batch.advantage - mean) / (jp.sqrt(variance) + 1e-8), 0.0)


def _share(x: jax.Array, batch: Batch, total_weight: jax.Array) -> jax.Array:
    """A part's share of a minibatch's mean over the rows that count."""
    return jp.sum(jp.where(batch.weight > 0, x, 0.0)) / jp.maximum(total_weight, 1.0)


def loss(
    outputs: Outputs, batch: Batch, advantage: jax.Array, total_weight: jax.Array, config: PPOConfig
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """A part's share of the minibatch's loss: the shares of all parts (devices, chunks) add up to the mean.

    Args:
        outputs: of the networks being trained, leading axis n.
        batch: the transitions.
        advantage: (n,) normalised advantages.
        total_weight: () summed weight of the whole minibatch.
        config: the coefficients.

    Returns:
        The share of the loss, `policy` and `value`, which add up to it; and the shares of its terms and diagnostics.
    """
    share = partial(_share, batch=batch, total_weight=total_weight)
    log_ratio = distribution.log_prob(batch.action, outputs.mean, outputs.log_std) - batch.log_prob
    log_ratio = jp.where(batch.weight > 0, log_ratio, 0.0)
    ratio = jp.exp(log_ratio)
    clipped = jp.clip(ratio, 1.0 - config.clip, 1.0 + config.clip)
    policy = share(-jp.minimum(ratio * advantage, clipped * advantage))
    value = share((outputs.value - batch.value - batch.advantage) ** 2)
    entropy = share(distribution.entropy(outputs.log_std))
    losses = {"policy": policy - config.entropy * entropy, "value": config.value_loss * value}
    terms = {
        "loss/total": losses["policy"] + losses["value"],
        "loss/policy": policy,
        "loss/value": value,
        "policy/entropy": entropy,
        "policy/approx_kl": share(ratio - 1.0 - log_ratio),  # Schulman's k3 estimator
        "policy/clip_fraction": share((jp.abs(ratio - 1.0) > config.clip).astype(ratio.dtype)),
        "policy/std": share(jp.exp(outputs.log_std).mean(-1)),
    }
    return losses, terms


def imitation(
    outputs: Outputs, batch: Batch, advantage: jax.Array, total_weight: jax.Array, config: PPOConfig
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """The loss of a policy that imitates a teacher (DAgger); arguments and results as for :func:`loss`.

    The mean action is drawn to the teacher's, the value learns what PPO's would; the standard deviation stays.
    """
    assert batch.label is not None
    share = partial(_share, batch=batch, total_weight=total_weight)
    difference = share(((jp.tanh(outputs.mean) - batch.label) ** 2).mean(-1))
    value = share((outputs.value - batch.value - batch.advantage) ** 2)
    losses = {"policy": difference, "value": config.value_loss * value}
    terms = {
        "loss/total": losses["policy"] + losses["value"],
        "loss/imitation": difference,
        "loss/value": value,
        "policy/std": share(jp.exp(outputs.log_std).mean(-1)),
    }
    return losses, terms
