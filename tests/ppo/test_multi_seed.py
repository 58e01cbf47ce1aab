"""Seeds in one program: each draws what it draws alone, learns the same to rounding, sees nothing of the others."""

from __future__ import annotations

import copy
import dataclasses
import functools

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.ppo.multi_seed import SeedsTrainer
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.sharding import make_mesh
from tests.ppo.probes import SignProbe, tiny

SEEDS = (4, 0, 9)  # not in order, so that a place taken for a seed shows
ITERATIONS = 3


@functools.cache
def _program():
    config = tiny(epochs=2, pool_refresh=2)
    return Trainer(config, SignProbe(horizon=6, start_spread=4), make_mesh(jax.devices()[:2]))


def _single(seed):
    """A seed's own trainer; all share compiled programs, in which the seed is an argument."""
    trainer = copy.copy(_program())
    trainer.config = dataclasses.replace(trainer.config, seed=seed)
    return trainer


@pytest.fixture(scope="module")
def together():
    return SeedsTrainer(_single(123), SEEDS)


def _train(trainer, state=None):
    state, history = trainer.init() if state is None else state, []
    for i in range(ITERATIONS):
        state, metrics = trainer.iterate(state, trainer.make_pool(i))
        history.append(jax.device_get(metrics))
    return state, history


@pytest.fixture(scope="module")
def alone():
    return [(jax.device_get(_single(seed).init()), *_train(_single(seed))) for seed in SEEDS]


def _assert_same(state, expected, tolerance=1e-6):
    """Keys, counts and what follows from them bit by bit; numbers that matrix products touch to a tolerance."""
    found, wanted = (jax.tree_util.tree_leaves_with_path(jax.device_get(tree)) for tree in (state, expected))
    for (path, x), (_, y) in zip(found, wanted, strict=True):
        assert (x.dtype, x.shape) == (y.dtype, y.shape)
        exact = not np.issubdtype(x.dtype, np.floating) or path[0].name == "env_state"
        check = np.testing.assert_array_equal if exact else np.testing.assert_allclose
        options = {} if exact else {"rtol": tolerance, "atol": tolerance}
        name = jax.tree_util.keystr(path)
        if name not in (".env_state.reward", ".env_state.info['episode']['return']"):  # the action's size is in them
            check(x, y, err_msg=name, **options)


def test_each_seed_starts_as_it_does_alone(together, alone):
    for part, (first, _, _) in zip(together.split(together.init()), alone, strict=True):
        _assert_same(part, first)
    pools = together.make_pool(2)
    for i, seed in enumerate(SEEDS):
        np.testing.assert_array_equal(pools[i], _single(seed).make_pool(2))


def test_each_seed_meets_the_same_world_and_learns_the_same_to_rounding(together, alone):
    states, history = _train(together)
    assert together.iterate._cache_size() == 1
    for i, (part, (_, expected, alone_history)) in enumerate(zip(together.split(states), alone, strict=True)):
        _assert_same(part, expected, tolerance=1e-5)
        assert part.env_state.done.sharding == expected.env_state.done.sharding
        for metrics, wanted in zip(history, alone_history, strict=True):
            for name, value in wanted.items():
                np.testing.assert_allclose(metrics[name][i], value, rtol=1e-3, atol=1e-5, err_msg=name)


def test_seeds_in_the_wrong_places_would_be_noticed(together, alone):
    swapped = [together.split(together.init())[i] for i in (1, 0, 2)]
    with pytest.raises(AssertionError):
        _assert_same(swapped[0], alone[0][0])
    key_alone = [dataclasses.replace(part, key=first.key) for part, (first, _, _) in zip(swapped, alone, strict=True)]
    with pytest.raises(AssertionError):  # the right key beside another seed's parameters and environments
        _assert_same(key_alone[1], alone[1][0])


def test_the_first_actions_draw_the_same_noise(together):
    """The noise, (action − mean) / std, to rounding; the initial Gaussian has mean nearly 0 and std 1."""
    trainer = together.trainer
    collect = jax.jit(jax.vmap(trainer.collect_on_device))
    states, pools = together.init(), together.make_pool(0)
    _, rollouts, _ = collect(jax.device_get(states), jax.device_get(pools))
    for i, seed in enumerate(SEEDS):
        single = _single(seed)
        _, rollout, _ = single.collect(single.init(), single.make_pool(0))
        np.testing.assert_allclose(rollouts.action[i], rollout.action, atol=1e-5)
        np.testing.assert_array_equal(rollouts.reset[i], rollout.reset)


def test_nothing_of_a_broken_seed_reaches_the_others(together):
    parts = together.split(together.init())
    broken = [
        parts[0],
        dataclasses.replace(parts[1], params=jax.tree.map(lambda x: x * jp.nan, parts[1].params)),
        parts[2],
    ]
    healthy_states, _ = _train(together, together.join(parts))
    states, history = _train(together, together.join(broken))
    assert not np.isfinite(history[0]["grad_norm"][1]) or history[0]["skipped_updates"][1] > 0
    for i in (0, 2):
        found, wanted = together.split(states)[i], together.split(healthy_states)[i]
        jax.tree.map(np.testing.assert_array_equal, jax.device_get(found), jax.device_get(wanted))
