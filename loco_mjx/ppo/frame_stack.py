"""Depth frames, each stored once; a minibatch puts the stacks together again.

A rollout of T steps keeps K−1 older frames and then T+1 newest ones, (K+T, B, H, W): row t + K − 1 is the frame that
was the newest at step t.
"""

from __future__ import annotations

import jax
import jax.numpy as jp

STORED = jp.float16  # 1e-3 in encoded depth; the policy sees the rounded frame when it acts, too


def rounded(stack: jax.Array) -> jax.Array:
    """The stack as it will be read back: through the stored type and back to float32."""
    return stack.astype(STORED).astype(jp.float32)


def older(stack: jax.Array) -> jax.Array:
    """(B, H, W, K) stacks, newest first, to the (K−1, B, H, W) frames before the newest, oldest first, as stored."""
    return jp.moveaxis(stack[..., :0:-1], -1, 0).astype(STORED)


def newest(stack: jax.Array) -> jax.Array:
    """(B, H, W, K) stacks to their newest frame (B, H, W), as stored."""
    return stack[..., 0].astype(STORED)


def episode_starts(reset: jax.Array, count: int) -> jax.Array:
    """Step at which the episode of each observation started.

    Args:
        reset: (T, B) 1 where the transition t spans a reset, so that observation t+1 is an episode's first.
        count: K.

    Returns:
        (T+1, B) int32; −(K−1), before the oldest frame kept, where the episode began before the rollout.
    """
    steps = jp.arange(1, reset.shape[0] + 1, dtype=jp.int32)[:, None]
    before = jp.full((1, reset.shape[1]), 1 - count, jp.int32)
    starts = jp.where(reset > 0, steps, before)
    return jax.lax.cummax(jp.concatenate([before, starts]), axis=0)


def stack(frames: jax.Array, starts: jax.Array, step: jax.Array, column: jax.Array, count: int) -> jax.Array:
    """The observation's stacks at some steps.

    Args:
        frames: (K+T, B, H, W) stored frames.
        starts: (T+1, B) from :func:`episode_starts`.
        step: (n,) int32 steps t.
        column: (n,) int32 environments.
        count: K.

    Returns:
        (n, H, W, K) float32, newest first; frames before the episode's start repeat its first one.
    """
    ages = jp.arange(count, dtype=jp.int32)
    rows = jp.maximum(step[:, None] - ages, starts[step, column][:, None]) + (count - 1)  # (n, K)
    picked = frames[rows, column[:, None]]  # (n, K, H, W)
    return jp.moveaxis(picked, 1, -1).astype(jp.float32)
