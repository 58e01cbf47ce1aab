"""PPO's loss on a minibatch. Transitions that span a reset have weight 0 and count nowhere."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jp
from flax import struct

from loco_mjx.config import PPOConfig
from loco_mjx.networks.outputs import Outputs
from loco_mjx.ppo import distribution


@struct.dataclass
class Minibatch:
    """Transitions to learn from; leading axis n.

    Attributes:
        action: (n, actions) as drawn, before the tanh.
        log_prob: (n,) of the policy that drew it, π_old.
        value: (n,) its value estimate, V_old.
        advantage: (n,) λ-advantage.
        weight: (n,) 1, or 0 for a transition that spans a reset.
        teacher_action: (n, actions) what a teacher would have done, in [−1, 1], or None without one.
    """

    action: jax.Array
    log_prob: jax.Array
    value: jax.Array
    advantage: jax.Array
    weight: jax.Array
    teacher_action: jax.Array | None = None


def psum(x: Any, axis_name: str | None) -> Any:
    """Sum of a pytree over the devices of a mesh axis, if one is named."""
    return x if axis_name is None else jax.lax.psum(x, axis_name)


def masked_mean(x: jax.Array, weight: jax.Array, axis_name: str | None = None) -> jax.Array:
    """Mean of x where weight is 1, over all devices of a mesh axis if one is named."""
    total = psum(jp.sum(jp.where(weight > 0, x, 0.0)), axis_name)
    return total / jp.maximum(psum(jp.sum(weight), axis_name), 1.0)


def normalized_advantage(minibatch: Minibatch, axis_name: str | None = None) -> jax.Array:
    """(n,) advantages with mean 0 and standard deviation 1 over the transitions that count, of all devices."""
    mean = masked_mean(minibatch.advantage, minibatch.weight, axis_name)
    variance = masked_mean((minibatch.advantage - mean) ** 2, minibatch.weight, axis_name)
    return jp.where(minibatch.weight > 0, (minibatch.advantage - mean) / (jp.sqrt(variance) + 1e-8), 0.0)


def _mean_term(x: jax.Array, minibatch: Minibatch, total_weight: jax.Array) -> jax.Array:
    """What these transitions add to the mean over the whole minibatch: Σ w x / Σ w of all."""
    return jp.sum(jp.where(minibatch.weight > 0, x, 0.0)) / jp.maximum(total_weight, 1.0)


def loss(
    outputs: Outputs, minibatch: Minibatch, advantage: jax.Array, total_weight: jax.Array, config: PPOConfig
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """What some transitions add to the minibatch's mean loss; the terms of all devices and chunks add up to it.

    Args:
        outputs: of the networks being trained, leading axis n.
        minibatch: the transitions.
        advantage: (n,) normalised advantages.
        total_weight: () summed weight of the whole minibatch.
        config: the coefficients.

    Returns:
        Terms of the losses `policy` and `value`, whose sum is the loss; and those of what is reported.
    """
    mean = partial(_mean_term, minibatch=minibatch, total_weight=total_weight)
    log_ratio = distribution.log_prob(minibatch.action, outputs.mean, outputs.log_std) - minibatch.log_prob
    log_ratio = jp.where(minibatch.weight > 0, log_ratio, 0.0)
    ratio = jp.exp(log_ratio)  # r = π(a|s) / π_old(a|s)
    clipped = jp.clip(ratio, 1.0 - config.clip, 1.0 + config.clip)
    # L_π = −E[min(r A, clip(r, 1 − ε, 1 + ε) A)]
    policy = mean(-jp.minimum(ratio * advantage, clipped * advantage))
    # L_V = E[(V(s) − (V_old(s) + A))²]: the advantage is not normalised here
    value = mean((outputs.value - minibatch.value - minibatch.advantage) ** 2)
    # L = L_π − c_H H + c_V L_V
    entropy = mean(distribution.entropy(outputs.log_std))
    losses = {"policy": policy - config.entropy * entropy, "value": config.value_loss * value}
    terms = {
        "loss/total": losses["policy"] + losses["value"],
        "loss/policy": policy,
        "loss/value": value,
        "policy/entropy": entropy,
        "policy/approx_kl": mean(ratio - 1.0 - log_ratio),  # E[r − 1 − log r], Schulman's k3 estimator
        "policy/clip_fraction": mean((jp.abs(ratio - 1.0) > config.clip).astype(ratio.dtype)),
        "policy/std": mean(jp.exp(outputs.log_std).mean(-1)),
    }
    return losses, terms


def imitation(
    outputs: Outputs, minibatch: Minibatch, advantage: jax.Array, total_weight: jax.Array, config: PPOConfig
) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
    """The loss of a policy that imitates a teacher (DAgger); arguments and results as for :func:`loss`.

    The mean action learns the teacher's action, the value what PPO's would; the standard deviation does not change.
    """
    assert minibatch.teacher_action is not None
    mean = partial(_mean_term, minibatch=minibatch, total_weight=total_weight)
    # L = E[mean_i (tanh μ_i − a_teacher,i)²] + c_V L_V
    difference = mean(((jp.tanh(outputs.mean) - minibatch.teacher_action) ** 2).mean(-1))
    value = mean((outputs.value - minibatch.value - minibatch.advantage) ** 2)
    losses = {"policy": difference, "value": config.value_loss * value}
    terms = {
        "loss/total": losses["policy"] + losses["value"],
        "loss/imitation": difference,
        "loss/value": value,
        "policy/std": mean(jp.exp(outputs.log_std).mean(-1)),
    }
    return losses, terms
