"""Arithmetic written so that XLA makes vector code of it.

Arrays in this room have their components first, then the four legs where there are legs, and the N environments last.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import jax
import jax.numpy as jp
import numpy as np

T = TypeVar("T")


class FusionBarrier:
    """Keeps XLA from computing a function's result again for each of its consumers.

    On CPUs XLA fuses cheap arithmetic into every one of its uses and computes it again for each, which for this much
    arithmetic costs more than anything else, and its own optimization barrier is gone by the time it fuses. A branch
    is never taken apart. On GPUs, where a branch waits for the host and XLA fuses better, functions are simply called.
    Under `jax.shard_map` this needs `check_vma=False`: the branch not taken is the same on all devices.
    """

    def __init__(self, always: jax.Array | None = None) -> None:
        """`always` is a scalar that is true, in a way that XLA cannot know while it compiles; None: no barrier."""
        self._always = always

    def __call__(self, function: Callable[..., T], *args: Any) -> T:
        """function(*args), finished."""
        if self._always is None or jax.default_backend() != "cpu":
            return function(*args)
        traced = jax.jit(function, inline=True)  # which keeps what it traced: for its shapes, and for the branch
        shapes = jax.eval_shape(traced, *args)
        zeros = lambda *_: jax.tree.map(lambda x: jp.zeros(x.shape, x.dtype), shapes)  # noqa: E731
        return jax.lax.cond(self._always, traced, zeros, *args)


def add_up(arrays: Iterable[jax.Array]) -> jax.Array:
    """Sum of arrays."""
    return functools.reduce(operator.add, arrays)


def total(array: jax.Array) -> jax.Array:
    """Sum over the first axis, written out: XLA's own reduction would not vectorise over the last."""
    return add_up(array[i] for i in range(array.shape[0]))


def column_sums(array: jax.Array) -> jax.Array:
    """Sum over the first, long axis of a matrix, finished before it is used.

    On CPUs by a product with ones: a written-out sum of a hundred rows would be compiled, and computed, again for each
    of its uses.
    """
    if jax.default_backend() != "cpu":
        return jp.sum(array, axis=0)
    ones = np.ones((array.shape[0],), np.float32)
    return jax.lax.dot(ones, array, precision=jax.lax.Precision.HIGHEST)
