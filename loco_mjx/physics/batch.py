"""Functions of many environments, written so that `jax.vmap` of one environment's calls them once.

`jax.custom_batching.custom_vmap` does that too, but traces the function for one environment first, only to throw that
away: for a control step that is half of the time before XLA starts to compile. So this is a primitive of our own, and
what it calls is traced when it is lowered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jp
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir


def together(many: Callable[..., Any], result: Any = None) -> Callable[..., Any]:
    """The function of one environment, of a function of N, on the first axis of every argument and result.

    `jax.vmap` of it is `many`, and a vmap of that (seeds × environments) is `many` of all of them together.

    Args:
        many: may not close over what JAX traces.
        result: its result for one environment, as a pytree of `jax.ShapeDtypeStruct`; None: it is traced to find out.

    Returns:
        The function; where it is compiled, it raises TypeError if `many` returns something other than `result` says.
    """

    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        first = [jp.asarray(leaf)[None] for leaf in leaves]
        described = _of_one(jax.eval_shape(many, *jax.tree.unflatten(tree, first))) if result is None else result
        shapes, out_tree = jax.tree.flatten(described)

        def run(*leaves: jax.Array) -> list[jax.Array]:
            with jax.default_matmul_precision("highest"):
                found = many(*jax.tree.unflatten(tree, leaves))
            if _of_one(found) != described:
                raise TypeError(f"one environment's result is {_of_one(found)}, declared is {described}")
            return jax.tree.leaves(found)

        known = tuple((leaf.shape, leaf.dtype) for leaf in shapes)
        found = _together.bind(*first, run=run, known=known)
        return jax.tree.unflatten(out_tree, [leaf[0] for leaf in found])

    return call


def _of_one(batch: Any) -> Any:
    """The shapes of one environment, of those of a batch."""
    return jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), batch)


_together = Primitive("together")
_together.multiple_results = True


@_together.def_impl
def _(*leaves: jax.Array, run: Callable[..., list[jax.Array]], known: Any) -> list[jax.Array]:
    return jax.jit(run)(*leaves)


@_together.def_abstract_eval
def _(*leaves: Any, run: Callable[..., list[jax.Array]], known: Any) -> list[jax.core.ShapedArray]:
    return [jax.core.ShapedArray((leaves[0].shape[0], *shape), dtype) for shape, dtype in known]


def _merge(leaves: Any, axes: Any, **params: Any) -> tuple[list[jax.Array], list[int]]:
    """One more mapped axis: it and the batch's become one."""
    size = next(x.shape[axis] for x, axis in zip(leaves, axes, strict=True) if axis is not None)
    spread = [
        jp.broadcast_to(x, (size, *x.shape)) if axis is None else jp.moveaxis(x, axis, 0)
        for x, axis in zip(leaves, axes, strict=True)
    ]
    count = spread[0].shape[1]
    found = _together.bind(*(x.reshape(size * count, *x.shape[2:]) for x in spread), **params)
    return [x.reshape(size, count, *x.shape[1:]) for x in found], [0] * len(found)


batching.primitive_batchers[_together] = _merge
mlir.register_lowering(_together, mlir.lower_fun(lambda *leaves, run, known: run(*leaves), multiple_results=True))
