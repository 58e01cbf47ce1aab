"""What changes over the length of a run: the learning rate, how widely a policy explores, its parameters' mean."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jp

from loco_mjx.config import PPOConfig
from loco_mjx.networks.outputs import LOG_STD, Params


def learning_rate(config: PPOConfig, iteration: jax.Array) -> jax.Array:
    """() rate of an iteration: constant, or falling linearly to 0 over `total_steps`."""
    rate = jp.asarray(config.learning_rate, jp.float32)
    if not config.learning_rate_decay:
        return rate
    return rate * jp.maximum(1.0 - iteration.astype(jp.float32) / config.iterations, 0.0)


def narrowed(params: Params, config: PPOConfig, initial_std: float, iteration: jax.Array) -> Params:
    """Parameters after an iteration, their log standard deviation (every `log_std` in the tree) at most the limit.

    The limit falls geometrically from `initial_std` to `final_std` over `total_steps`.
    """
    if config.final_std is None:
        return params
    done = jp.minimum((iteration.astype(jp.float32) + 1.0) / config.iterations, 1.0)
    limit = (1.0 - done) * math.log(initial_std) + done * math.log(config.final_std)

    def lower(path: tuple[Any, ...], leaf: jax.Array) -> jax.Array:
        return jp.minimum(leaf, limit) if getattr(path[-1], "key", None) == LOG_STD else leaf

    return jax.tree_util.tree_map_with_path(lower, params)


def averaged(mean: Params | None, params: Params, config: PPOConfig, iteration: jax.Array) -> Params | None:
    """The mean of the parameters after an iteration (0 is the first), from the mean before it; None without one.

    Parameters of the past weigh less by a factor `average` with every iteration; of the first few all weigh the same.
    (Polyak and Juditsky 1992, with weights that fall.)
    """
    if mean is None:
        return None
    count = iteration.astype(jp.float32)
    decay = jp.minimum(config.average, count / (count + 1.0))
    return jax.tree.map(lambda mean, new: decay * mean + (1.0 - decay) * new, mean, params)
