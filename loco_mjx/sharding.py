"""The devices as one axis: cores, GPUs, one mechanism."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

AXIS = "env"  # the environments' axis


def make_mesh(devices: Sequence[jax.Device] | None = None) -> Mesh:
    """A mesh with one axis, over these devices or all there are, those of other processes included."""
    return Mesh(np.array(jax.devices() if devices is None else devices), (AXIS,))


def dividing_devices(size: int) -> list[jax.Device]:
    """The most local devices over which a number of environments divides."""
    devices = jax.local_devices()
    return devices[: max(n for n in range(1, len(devices) + 1) if size % n == 0)]


def shard_map(part: Callable, mesh: Mesh, in_specs: Any, out_specs: Any) -> Callable:
    """As `jax.shard_map`, but arguments and constants may have no elements.

    Args:
        part: what one device does with its shard of the arguments.
        mesh: of `make_mesh`.
        in_specs: PartitionSpecs of the arguments.
        out_specs: PartitionSpecs of the results.
    """

    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        specs = jax.tree.leaves(jax.tree.broadcast(in_specs, args))
        # JAX 0.11's partitioner (Shardy) crashes on an argument without elements, such as the spheres of a scene that
        # has none, or MJX's list of a robot's ball joints: they are made anew on the device.
        passed = [i for i, leaf in enumerate(leaves) if leaf.size]

        def on_device(*shards: jax.Array) -> Any:
            given = dict(zip(passed, shards, strict=True))
            made = [given[i] if i in given else _empty(leaf, specs[i], mesh) for i, leaf in enumerate(leaves)]
            return _with_own_empties(part, jax.tree.unflatten(tree, made))

        # check_vma: the physics' branches hold values that are the same on all devices, which JAX cannot tell.
        run = jax.shard_map(
            on_device, mesh=mesh, in_specs=tuple(specs[i] for i in passed), out_specs=out_specs, check_vma=False
        )
        return run(*(leaves[i] for i in passed))

    return call


def _with_own_empties(part: Callable, args: Sequence[Any]) -> Any:
    """Calls a part, whose constants become arguments of its device's program: those without elements are made there."""
    program, shapes = jax.make_jaxpr(part, return_shape=True)(*args)
    constants = [jp.zeros(c.shape, c.dtype) if jp.size(c) == 0 else c for c in program.consts]
    results = jax.core.eval_jaxpr(program.jaxpr, constants, *jax.tree.leaves(args))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def _empty(leaf: jax.Array, spec: P, mesh: Mesh) -> jax.Array:
    """One device's shard of an array without elements."""
    return jp.zeros(NamedSharding(mesh, spec).shard_shape(leaf.shape), leaf.dtype)
