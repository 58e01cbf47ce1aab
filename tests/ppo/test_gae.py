"""λ-advantages against numbers computed by hand; γ = 0.5, λ = 0.5, so that γλ = 0.25."""

from __future__ import annotations

import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.ppo.gae import advantages

GAMMA, LAMBDA = 0.5, 0.5


def _advantages(rewards, values, terminated=(), done=(), reset=()):
    """Rows named in `terminated`, `done` and `reset` are flagged; a terminated row is done."""
    flags = [
        np.isin(np.arange(len(rewards)), rows).astype(np.float32) for rows in (terminated, (*done, *terminated), reset)
    ]
    return advantages(jp.array(rewards, jp.float32), jp.array(values, jp.float32), *flags, GAMMA, LAMBDA)


def test_running_rows():
    # deltas: 1 + 2 − 2 = 1;  2 + 4 − 4 = 2;  3 + 1 − 8 = −4
    got = _advantages([1, 2, 3], [2, 4, 8, 2])
    np.testing.assert_allclose(got, [1 + 0.25 * (2 - 1), 2 - 1, -4])


def test_terminal_row_cuts_bootstrap_and_sum():
    # deltas: 1;  2 − 4 = −2 without the next value;  −4
    got = _advantages([1, 2, 3], [2, 4, 8, 2], terminated=[1])
    np.testing.assert_allclose(got, [1 - 0.25 * 2, -2, -4])


def test_truncated_row_bootstraps_but_cuts_the_sum():
    got = _advantages([1, 2, 3], [2, 4, 8, 2], done=[1])
    np.testing.assert_allclose(got, [1 + 0.25 * 2, 2, -4])


@pytest.mark.parametrize("ending", ["terminated", "done"])
def test_reset_row_has_no_advantage_and_touches_no_other(ending):
    def run(reward, value_after):
        # Row 1 ends the episode, row 2 resets, row 3 is the next episode's first.
        rewards, values = [1, 2, reward, 5], [2, 4, 8, value_after, 6]
        return _advantages(rewards, values, **{ending: [1]}, reset=[2])

    last = {"terminated": -2, "done": 2}[ending]
    expected = [1 + 0.25 * last, last, 0, 5 + 3 - 16]
    np.testing.assert_allclose(run(reward=0, value_after=16), expected)
    np.testing.assert_allclose(run(reward=1e6, value_after=16), expected)
    # The value of a fresh observation belongs to the row that starts there, and to no earlier one.
    np.testing.assert_allclose(run(reward=0, value_after=-1e6)[:3], expected[:3])


def test_last_row_done():
    np.testing.assert_allclose(_advantages([1, 2], [2, 4, 8], terminated=[1]), [1 - 0.5, -2])
    np.testing.assert_allclose(_advantages([1, 2], [2, 4, 8], done=[1]), [1 + 0.5, 2])


def test_columns_are_independent():
    one = _advantages([1, 2, 3], [2, 4, 8, 2], terminated=[1])
    other = _advantages([0, 5, 1], [1, 1, 1, 1], done=[0])
    flags = [np.zeros((3, 2), np.float32) for _ in range(3)]
    flags[0][1, 0] = flags[1][1, 0] = flags[1][0, 1] = 1
    rewards, values = jp.array([[1, 0], [2, 5], [3, 1.0]]), jp.array([[2, 1], [4, 1], [8, 1], [2, 1.0]])
    both = advantages(rewards, values, *flags, GAMMA, LAMBDA)
    np.testing.assert_allclose(both, np.stack([one, other], -1))


def test_lambda_one_is_the_discounted_return():
    zeros = jp.zeros(3)
    got = advantages(jp.array([1.0, 1.0, 1.0]), jp.array([7.0, -3.0, 2.0, 8.0]), zeros, zeros, zeros, 0.5, 1.0)
    returns = np.array([1 + 0.5 + 0.25 + 0.125 * 8, 1 + 0.5 + 0.25 * 8, 1 + 0.5 * 8])
    np.testing.assert_allclose(got, returns - np.array([7, -3, 2]), rtol=1e-6)
