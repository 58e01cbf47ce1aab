"""The gait's clock, and what it makes of contacts."""

import numpy as np
import pytest

from loco_mjx.controllers import TICK
from loco_mjx.whole_body import gait
from loco_mjx.whole_body.config import Gait

TROT = Gait()
FR_RL, FL_RR = np.array([True, False, False, True]), np.array([False, True, True, False])


def test_diagonal_pairs_swing_in_turn_and_stand_for_a_quarter_of_a_second():
    ticks = np.arange(250)  # 3 cycles
    swings = gait.phase(TROT, ticks * TICK).swings
    assert all(row.tolist() in ([False] * 4, FR_RL.tolist(), FL_RR.tolist()) for row in swings)
    assert not swings[0].any() and swings[10].tolist() == FR_RL.tolist()  # 50 ms: the cycle's first tenth is over
    for leg in range(4):
        assert np.mean(swings[:, leg]) == pytest.approx(0.4, abs=0.005)
        changes = np.flatnonzero(np.diff(swings[:, leg].astype(int)) == -1)
        stance = np.flatnonzero(np.diff(swings[:, leg].astype(int)) == 1)
        first = [end - begin for begin, end in zip(changes, stance[stance > changes[0]], strict=False)]
        assert set(first) <= {49, 50, 51}


def test_parts_run_from_0_to_1():
    phase = gait.phase(TROT, np.arange(0, 1, 1e-3))
    assert phase.part.min() >= 0 and phase.part.max() < 1
    begins = np.flatnonzero(np.diff(phase.swings[:, 0].astype(int)))
    assert np.all(phase.part[begins + 1, 0] < 0.02) and np.all(phase.part[begins, 0] > 0.98)


def test_rounding_does_not_decide():
    """The stance's end is a tick exactly; in float32 and float64 it is the same one."""
    ticks = np.arange(8000)
    single = gait.phase(TROT, (ticks * TICK).astype(np.float32))
    double = gait.phase(TROT, ticks * TICK)
    np.testing.assert_array_equal(single.swings, double.swings)
    np.testing.assert_array_equal(single.part >= TROT.blind, double.part >= TROT.blind)


@pytest.mark.parametrize(("part", "heard"), [(0.05, False), (0.5, True)])
def test_contacts_count_once_a_part_has_begun(part, heard):
    now = gait.Phase(FR_RL, np.full(4, part))
    touching = gait.mode(TROT, now, np.array([True, True, False, False]))
    assert touching.early.tolist() == [heard, False, False, False]
    assert touching.lost.tolist() == [False, False, heard, False]
    assert touching.pushes.tolist() == [heard, True, True, False]
