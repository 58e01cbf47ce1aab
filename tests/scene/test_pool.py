from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.scene.pool import CHUNK, draw, make_pool
from loco_mjx.scene.tasks import get_task


@pytest.mark.parametrize("size", [3, CHUNK + 6])
def test_any_size_every_scene_another(size):
    pool = make_pool(jax.random.PRNGKey(0), get_task("thin-sphere"), size)
    assert all(leaf.shape[0] == size for leaf in jax.tree.leaves(pool))
    assert len(np.unique(np.asarray(pool.spheres.center).reshape(size, -1), axis=0)) == size


def test_the_key_decides():
    task = get_task("wide")
    pools = [make_pool(jax.random.PRNGKey(seed), task, 3).boxes.center for seed in (0, 0, 1)]
    np.testing.assert_array_equal(pools[0], pools[1])
    assert not np.isclose(pools[0], pools[2]).all(axis=(1, 2)).any()


def test_draws_are_members_each_with_equal_chance():
    pool = make_pool(jax.random.PRNGKey(0), get_task("wide-sphere"), 5)
    drawn = jax.jit(jax.vmap(draw, in_axes=(0, None)))(jax.random.split(jax.random.PRNGKey(1), 2000), pool)
    assert jax.tree.structure(drawn) == jax.tree.structure(pool)
    same = (drawn.spheres.center[:, None] == pool.spheres.center[None]).all(axis=(2, 3))
    boxes = (drawn.boxes.center[:, None] == pool.boxes.center[None]).all(axis=(2, 3))
    np.testing.assert_array_equal(same, boxes)  # a scene stays whole
    np.testing.assert_array_equal(same.sum(axis=1), 1)
    np.testing.assert_allclose(same.mean(axis=0), 0.2, atol=0.04)


def test_no_weak_types():
    scene = draw(jax.random.PRNGKey(2), make_pool(jax.random.PRNGKey(0), get_task("mountain"), 3))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(scene))
    assert {leaf.dtype for leaf in jax.tree.leaves(scene)} == {np.dtype(t) for t in ("float32", "int32", "bool")}
    assert scene.terrain.heights.shape == (200, 160) and scene.goal.shape == (3,)
    assert jp.isfinite(scene.terrain.heights).all()
