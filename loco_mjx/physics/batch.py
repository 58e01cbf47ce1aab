"""Functions of many environments, written so that `jax.vmap` of one environment's calls them once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jp


def together(many: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one environment, of a function of N, on the first axis of every argument and result.

    `jax.vmap` of it is `many`, and a vmap of that (seeds × environments) is `many` of all of them together.
    """

    def call(*args: Any) -> Any:
        @jax.custom_batching.custom_vmap
        def one(*args: Any) -> Any:
            first = jax.tree.map(lambda x: jp.asarray(x)[None], args)
            return jax.tree.map(lambda x: x[0], all_of(*first))

        @one.def_vmap
        def _(size: int, batched: Any, *args: Any) -> tuple[Any, Any]:
            out = all_of(*_broadcast(size, batched, args))
            return out, jax.tree.map(lambda _: True, out)

        @jax.custom_batching.custom_vmap
        def all_of(*args: Any) -> Any:
            with jax.default_matmul_precision("highest"):
                return many(*args)

        @all_of.def_vmap
        def _(size: int, batched: Any, *args: Any) -> tuple[Any, Any]:
            args = _broadcast(size, batched, args)
            count = jax.tree.leaves(args)[0].shape[1]
            merged = jax.tree.map(lambda x: x.reshape(size * count, *x.shape[2:]), args)
            out = jax.tree.map(lambda x: x.reshape(size, count, *x.shape[1:]), all_of(*merged))
            return out, jax.tree.map(lambda _: True, out)

        return one(*args)

    return call


def _broadcast(size: int, batched: Any, args: Any) -> Any:
    """The arguments, each with the mapped axis in front."""
    repeat = lambda x, is_batched: x if is_batched else jp.broadcast_to(x, (size, *jp.shape(x)))  # noqa: E731
    return jax.tree.map(repeat, args, tuple(batched))
