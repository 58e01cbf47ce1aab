from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.scene.motion import DIRECTIONS, REDRAW_STEPS, move, redraw
from loco_mjx.scene.types import OBSTACLE, WALL
from tests.scene.scenes import pool

SPEEDS = (0.375, 0.3 * 2**0.5, (0.15**2 + 0.45**2) ** 0.5)


@pytest.fixture(scope="module")
def scenes():
    return pool("moving")


def test_twenty_directions_four_of_them_at_rest():
    speeds = np.linalg.norm(DIRECTIONS, axis=1)
    assert len(DIRECTIONS) == 20 and (speeds == 0).sum() == 4
    assert all(np.min(np.abs(speed - np.array((0, *SPEEDS)))) < 1e-6 for speed in speeds)
    assert speeds[speeds > 0].min() == 0.375 and speeds.max() < 0.475
    assert len({d for d in DIRECTIONS if d != (0.0, 0.0)}) == 16
    np.testing.assert_allclose(np.sum(DIRECTIONS, axis=0), 0.0, atol=1e-9)  # no way is favoured


def test_obstacles_move_in_those_directions_and_walls_stand(scenes):
    velocity, obstacle = scenes.boxes.velocity, scenes.boxes.kind == OBSTACLE
    assert not velocity[scenes.boxes.kind == WALL].any()
    drawn = velocity[obstacle]
    offset = np.abs(drawn[:, None] - np.array(DIRECTIONS, np.float32)).max(axis=-1)
    assert offset.min(axis=1).max() == 0.0
    index = offset.argmin(axis=1)
    share = np.bincount(np.where((drawn == 0).all(axis=1), 16, index), minlength=17) / len(drawn)
    np.testing.assert_allclose(share, [0.05] * 16 + [0.2], atol=0.025)


def test_move_goes_on_for_dt(scenes):
    before = jax.tree.map(lambda leaf: leaf[0], scenes)
    after = move(before, 0.04)
    # 73 m away, neighbouring numbers are 8 µm apart.
    np.testing.assert_allclose(
        after.boxes.center[:, :2] - before.boxes.center[:, :2], 0.04 * before.boxes.velocity, atol=8e-6
    )
    np.testing.assert_array_equal(after.boxes.center[:, 2], before.boxes.center[:, 2])
    assert after.boxes.center.dtype == jp.float32 and not after.boxes.center.weak_type


@pytest.mark.parametrize("step", [0, 1, 149, 151, 299])
def test_directions_hold_between(scenes, step):
    scene = jax.tree.map(lambda leaf: leaf[0], scenes)
    after = jax.jit(redraw)(jax.random.PRNGKey(0), scene, jp.int32(step))
    np.testing.assert_array_equal(after.boxes.velocity, scene.boxes.velocity)


@pytest.mark.parametrize("step", [REDRAW_STEPS, 2 * REDRAW_STEPS, 900])
def test_directions_turn_back_or_are_redrawn(scenes, step):
    keys = jax.random.split(jax.random.PRNGKey(1), 64)
    after = np.asarray(jax.jit(jax.vmap(redraw, in_axes=(0, 0, None)))(keys, scenes, jp.int32(step)).boxes.velocity)
    before, obstacle = scenes.boxes.velocity, scenes.boxes.kind == OBSTACLE
    axis = ((before[..., 0] == 0) != (before[..., 1] == 0)) & obstacle
    np.testing.assert_array_equal(after[axis], -before[axis])
    other = obstacle & ~axis
    assert 0.01 < (after[other] == before[other]).all(axis=-1).mean() < 0.2
    assert (after[other] == 0).all(axis=-1).mean() == pytest.approx(0.2, abs=0.04)
    assert not after[~obstacle].any()
    assert REDRAW_STEPS == 150
