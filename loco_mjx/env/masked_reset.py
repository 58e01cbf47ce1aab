"""Resetting where an episode is over, without touching the environments in which it goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jp

T = TypeVar("T")


def masked_reset(reset: Callable[[jax.Array, Any], T], done: jax.Array, key: jax.Array, state: T, pool: Any) -> T:
    """``state``, or ``reset(key, pool)`` where ``done``; write it for one environment and ``jax.vmap`` it.

    To reset everywhere and select copies every environment's scene in every step, and a heightfield is large. Under
    ``jax.vmap`` a CPU therefore resets one by one, in place, and only where an episode is over. Elsewhere a loop whose
    length the data decide would wait for the host, and copies are cheap.

    Args:
        reset: (key, pool) -> the first state of an episode.
        done: bool scalar.
        key: what ``reset`` takes.
        state: as ``reset`` returns it.
        pool: what ``reset`` takes, the same for all environments.
    """

    def one(done: jax.Array, key: jax.Array, state: T, pool: Any) -> T:
        return jax.tree.map(lambda new, old: jp.where(done, new, old), reset(key, pool), state)

    mapped = jax.custom_batching.custom_vmap(one)
    in_turn = _in_turn(reset)

    @mapped.def_vmap
    def rule(axis_size: int, in_batched: list[Any], *args: Any) -> tuple[T, Any]:
        # What is the same for all environments, but for the pool, is repeated: it may differ after this step.
        repeat = lambda batched, x: x if batched else jp.broadcast_to(x, (axis_size, *x.shape))  # noqa: E731
        rows = jax.tree.map(repeat, in_batched[:3], list(args[:3]))
        pool_axis = jax.tree.map(lambda batched: 0 if batched else None, in_batched[3])
        together: Callable[..., T] = jax.vmap(one, (0, 0, 0, pool_axis))
        if any(jax.tree.leaves(in_batched[3])):
            reset_ones = together(*rows, args[3])
        else:
            reset_ones = jax.lax.platform_dependent(*rows, args[3], cpu=in_turn, default=together)
        return reset_ones, jax.tree.map(lambda _: True, reset_ones)

    return mapped(done, key, state, pool)


def _in_turn(reset: Callable[[jax.Array, Any], T]) -> Callable[..., T]:
    """(done, key, state, pool) -> the states of B environments; all but the pool have a leading axis of B."""

    @jax.custom_batching.custom_vmap
    def in_turn(done: jax.Array, key: jax.Array, state: T, pool: Any) -> T:
        over = jp.nonzero(done, size=done.shape[0], fill_value=0)[0]

        def reset_one(number: jax.Array, states: T) -> T:
            row = over[number]
            fresh = reset(key[row], pool)
            return jax.tree.map(lambda old, new: old.at[row].set(new.astype(old.dtype)), states, fresh)

        return jax.lax.fori_loop(0, jp.sum(done, dtype=jp.int32), reset_one, state)

    @in_turn.def_vmap
    def rule(axis_size: int, in_batched: list[Any], *args: Any) -> tuple[T, Any]:
        # Seeds, one after the other: a loop over all of them at once would copy every state in every round.
        repeat = lambda batched, x: x if batched else jp.broadcast_to(x, (axis_size, *x.shape))  # noqa: E731
        reset_ones = jax.lax.map(lambda seed: in_turn(*seed), tuple(jax.tree.map(repeat, in_batched, list(args))))
        return reset_ones, jax.tree.map(lambda _: True, reset_ones)

    return in_turn
