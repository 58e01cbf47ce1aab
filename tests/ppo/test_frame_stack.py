"""Rebuilding stacks of frames by index, with frames that are just numbers."""

from __future__ import annotations

import jax.numpy as jp
import numpy as np

from loco_mjx.ppo import frame_stack


def _stored(values):
    """One environment's (n,) numbers as (n, 1, 1, 1) frames."""
    return jp.array(values, jp.float16)[:, None, None, None]


def test_episode_starts():
    reset = jp.array([[0, 0], [1, 0], [0, 0], [1, 1]], jp.float32)
    starts = frame_stack.episode_starts(reset, 4)
    np.testing.assert_array_equal(starts[:, 0], [-3, -3, 2, 2, 4])
    np.testing.assert_array_equal(starts[:, 1], [-3, -3, -3, -3, 4])


def test_stacks_around_a_boundary():
    # Frames −3…−1 come from before the window; observation 2 is the first of a new episode.
    stored = _stored([-30, -20, -10, 0, 10, 20, 30, 40])
    starts = frame_stack.episode_starts(jp.array([[0], [1], [0], [0]], jp.float32), 4)
    steps = jp.arange(5, dtype=jp.int32)
    got = frame_stack.stack(stored, starts, steps, jp.zeros(5, jp.int32), 4)
    expected = [[0, -10, -20, -30], [10, 0, -10, -20], [20, 20, 20, 20], [30, 20, 20, 20], [40, 30, 20, 20]]
    np.testing.assert_array_equal(got[:, 0, 0], expected)
    assert got.dtype == jp.float32


def test_a_stack_is_stored_and_read_back():
    shown = jp.array([0.5, 0.25, -0.75, 0.1])[None, None, None]  # newest first
    stored = jp.concatenate([frame_stack.older(shown), frame_stack.newest(shown)[None]])
    starts = frame_stack.episode_starts(jp.zeros((0, 1)), 4)
    got = frame_stack.stack(stored, starts, jp.zeros(1, jp.int32), jp.zeros(1, jp.int32), 4)
    np.testing.assert_array_equal(got, frame_stack.rounded(shown))
    np.testing.assert_allclose(got, shown, atol=5e-4)
