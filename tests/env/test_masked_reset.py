from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.env.masked_reset import masked_reset

COUNT, SEEDS = 6, 3
DONE = np.array([[0, 1, 0, 0, 1, 1], [0] * COUNT, [1] * COUNT], bool)


def begin(key: jax.Array, pool: jax.Array) -> dict[str, jax.Array]:
    row = jax.random.randint(key, (), 0, pool.shape[0])
    return {"scene": pool[row], "row": row, "none": jp.zeros((0, 2)), "count": jp.zeros(())}


def states(seeds: int = SEEDS) -> dict[str, jax.Array]:
    scene = -1.0 - jp.arange(float(seeds * COUNT * 4)).reshape(seeds, COUNT, 4)
    row = jp.full((seeds, COUNT), -1)
    return {"scene": scene, "row": row, "none": jp.zeros((seeds, COUNT, 0, 2)), "count": jp.ones((seeds, COUNT))}


POOLS = 100.0 * jp.arange(1.0, SEEDS + 1)[:, None, None] + jp.arange(20.0).reshape(5, 4)
KEYS = jax.random.split(jax.random.PRNGKey(0), (SEEDS, COUNT))


def expected(seed: int) -> dict[str, np.ndarray]:
    """One environment after the other, without vmap."""
    result = jax.tree.map(lambda x: np.array(x[seed]), states())
    for number in np.flatnonzero(DONE[seed]):
        fresh = begin(KEYS[seed, number], POOLS[seed])
        for name, value in fresh.items():
            result[name][number] = value
    return result


def one(done: jax.Array, key: jax.Array, state: dict[str, jax.Array], pool: jax.Array) -> dict[str, jax.Array]:
    return masked_reset(begin, done, key, state, pool)


BATCH = jax.vmap(one, (0, 0, 0, None))


@pytest.mark.parametrize("seed", range(SEEDS))
def test_only_what_is_done_begins_anew(seed):
    state = jax.tree.map(lambda x: x[seed], states())
    jax.tree.map(
        np.testing.assert_array_equal, jax.jit(BATCH)(DONE[seed], KEYS[seed], state, POOLS[seed]), expected(seed)
    )


@pytest.mark.parametrize("pool_axis", [0, None])
def test_seeds_do_not_mix(pool_axis):
    pools = POOLS if pool_axis == 0 else POOLS[1]
    found = jax.jit(jax.vmap(BATCH, (0, 0, 0, pool_axis)))(DONE, KEYS, states(), pools)
    for seed in range(SEEDS) if pool_axis == 0 else [1]:
        jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda x, s=seed: x[s], found), expected(seed))


def test_a_state_that_all_environments_share_is_told_apart():
    state = jax.tree.map(lambda x: x[0, 0], states())
    found = jax.jit(jax.vmap(one, (0, 0, None, None)))(DONE[0], KEYS[0], state, POOLS[0])
    kept = ~DONE[0]
    np.testing.assert_array_equal(found["scene"][kept], np.tile(state["scene"], (kept.sum(), 1)))
    np.testing.assert_array_equal(found["scene"][DONE[0]], expected(0)["scene"][DONE[0]])


def test_every_environment_with_a_pool_of_its_own():
    state = jax.tree.map(lambda x: x[0], states())
    pools = jp.broadcast_to(POOLS[0], (COUNT, *POOLS[0].shape))
    jax.tree.map(np.testing.assert_array_equal, jax.jit(jax.vmap(one))(DONE[0], KEYS[0], state, pools), expected(0))


def test_without_a_batch():
    for seed in (0, 1):
        state = jax.tree.map(lambda x, s=seed: x[s, 1], states())
        found = jax.jit(one)(DONE[seed, 1], KEYS[seed, 1], state, POOLS[seed])
        jax.tree.map(np.testing.assert_array_equal, found, jax.tree.map(lambda x: x[1], expected(seed)))


def test_on_a_cpu_only_where_it_is_done_is_anything_begun():
    if jax.default_backend() != "cpu":
        pytest.skip("elsewhere every environment begins anew, and what is not wanted is thrown away")
    begun: list[int] = []

    def counted(key: jax.Array, pool: jax.Array) -> dict[str, jax.Array]:
        fresh = begin(key, pool)
        jax.debug.callback(lambda row: begun.extend(np.ravel(row).tolist()), fresh["row"])
        return fresh

    step = jax.vmap(lambda *args: masked_reset(counted, *args), (0, 0, 0, None))
    jax.block_until_ready(jax.jit(step)(DONE[0], KEYS[0], jax.tree.map(lambda x: x[0], states()), POOLS[0]))
    jax.effects_barrier()
    assert sorted(begun) == sorted(expected(0)["row"][DONE[0]].tolist())
