"""Pools of scenes, generated once for all tests, as NumPy arrays."""

from __future__ import annotations

from functools import cache

import jax
import numpy as np

from loco_mjx.scene.pool import make_pool
from loco_mjx.scene.tasks import get_task
from loco_mjx.scene.types import Scene
from tests.quick import OPTIMISED

SIZE = 64


@cache
def pool(task: str, size: int = SIZE) -> Scene:
    make = jax.jit(
        lambda key: make_pool(key, get_task(task), size), compiler_options=OPTIMISED if size > SIZE else None
    )
    return jax.tree.map(np.asarray, make(jax.random.PRNGKey(3)))


def one(task: str, index: int = 0) -> Scene:
    return jax.tree.map(lambda leaf: leaf[index], pool(task))
