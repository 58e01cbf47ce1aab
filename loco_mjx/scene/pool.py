"""Scenes generated ahead of time: a reset draws one from the pool, which is a gather."""

from __future__ import annotations

from functools import partial

import jax

from loco_mjx.scene.tasks import Task
from loco_mjx.scene.types import Scene

CHUNK = 64  # scenes generated at once


@partial(jax.jit, static_argnames=("task", "size"))
def make_pool(key: jax.Array, task: Task, size: int) -> Scene:
    """Generates ``size`` independent scenes of a task, in chunks, in one compiled program.

    Args:
        key: random key.
        task: whose scenes.
        size: how many.

    Returns:
        A Scene whose every array has a leading axis of length ``size``.
    """
    chunk = min(CHUNK, size)
    chunks = -(-size // chunk)
    scenes = jax.lax.map(jax.vmap(task.generate), jax.random.split(key, (chunks, chunk)))
    # Sizes spelled out, since -1 cannot be inferred for a scene without, say, spheres.
    return jax.tree.map(lambda leaf: leaf.reshape(chunks * chunk, *leaf.shape[2:])[:size], scenes)


def draw(key: jax.Array, pool: Scene) -> Scene:
    """One scene of the pool, each with equal chance.

    Args:
        key: random key.
        pool: what :func:`make_pool` returned.
    """
    size = jax.tree.leaves(pool)[0].shape[0]
    index = jax.random.randint(key, (), 0, size)  # index = +U{0..size-1}
    return jax.tree.map(lambda leaf: leaf[index], pool)
