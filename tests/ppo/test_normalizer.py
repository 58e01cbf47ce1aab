"""The running statistics against numpy over everything seen."""

from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.ppo import normalizer as lib


def _batches():
    draw = np.random.default_rng(0)
    return [draw.normal([3.0, -100.0], [0.1, 20.0], (count, 2)).astype(np.float32) for count in (6, 50, 200)]


def test_statistics_equal_numpys_over_all_batches():
    statistics = lib.create(2)
    for batch in _batches():
        statistics = lib.update(statistics, batch.reshape(2, -1, 2), jp.ones((2, len(batch) // 2)))
    seen = np.concatenate(_batches())
    assert float(statistics.count) == 256
    np.testing.assert_allclose(statistics.mean, seen.mean(0), rtol=1e-5)
    np.testing.assert_allclose(lib.std(statistics), seen.std(0), rtol=1e-3)
    normalized = lib.normalize(statistics, seen)
    np.testing.assert_allclose(normalized.mean(0), 0, atol=1e-3)
    np.testing.assert_allclose(normalized.std(0), 1, rtol=1e-3)


def test_rows_of_weight_zero_leave_no_trace():
    batch = _batches()[1]
    weight = (np.arange(50) % 3 > 0).astype(np.float32)
    masked = lib.update(lib.create(2), np.where(weight[:, None] > 0, batch, np.nan), weight)
    jax.tree.map(
        lambda got, expected: np.testing.assert_allclose(got, expected, rtol=1e-5),
        masked,
        lib.update(lib.create(2), batch[weight > 0], jp.ones(int(weight.sum()))),
    )


def test_devices_share_one_set_of_statistics():
    batch = _batches()[2].reshape(2, 100, 2)
    weight = jp.ones((2, 100)).at[1, :30].set(0)
    update = jax.vmap(lambda x, w: lib.update(lib.create(2), x, w, "env"), axis_name="env")
    expected = lib.update(lib.create(2), batch, weight)
    spread = update(batch, weight)
    for device in range(2):
        jax.tree.map(lambda got, want, i=device: np.testing.assert_allclose(got[i], want, rtol=1e-5), spread, expected)


def test_before_anything_was_seen_it_only_clips():
    got = lib.normalize(lib.create(3), jp.array([0.5, -3.0, 99.0]))
    np.testing.assert_allclose(got, [0.5, -3.0, 10.0], rtol=1e-6)


def test_an_update_without_rows_changes_nothing():
    before = lib.update(lib.create(2), _batches()[0], jp.ones(6))
    after = lib.update(before, _batches()[1], jp.zeros(50))
    jax.tree.map(np.testing.assert_array_equal, before, after)


def test_outliers_are_clipped_and_constants_stay_finite():
    statistics = lib.update(lib.create(2), jp.tile(jp.array([[1.0, 5.0], [3.0, 5.0]]), (8, 1)), jp.ones(16))
    np.testing.assert_allclose(lib.normalize(statistics, jp.array([2.0 + 50.0, 5.0])), [10.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(lib.normalize(statistics, jp.array([2.0 - 50.0, 6.0])), [-10.0, 10.0])
