"""When legs swing: a trot by the clock, which listens to the feet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loco_mjx.whole_body.arrays import Array, space
from loco_mjx.whole_body.config import Gait

AHEAD = 1e-4  # cycles that the clock is ahead: rounding then never decides on which side of an edge a tick falls


class Phase(NamedTuple):
    """Where the legs are in their cycle.

    Attributes:
        swings: (4,) bool, whether the clock lets the leg swing.
        part: (4,) of the swing or the stance that has passed, in [0, 1).
    """

    swings: Array
    part: Array


class Mode(NamedTuple):
    """What the legs do.

    Attributes:
        pushes: (4,) bool, the leg stands, by the clock or because it touched ground early in its swing.
        early: (4,) bool, it swings by the clock and touches ground.
        lost: (4,) bool, it stands by the clock and touches nothing.
    """

    pushes: Array
    early: Array
    lost: Array


def phase(gait: Gait, time: Array) -> Phase:
    """Where the clock has the legs at a time, s; times of any shape come before the legs in the result's."""
    xp = space(time)
    first = np.array(gait.swings_first)
    length = np.where(first, 1 - gait.duty, gait.duty).astype(np.float32)  # of the cycle's first part
    cycles = time[..., None] / gait.cycle + np.array(gait.phases, np.float32) + AHEAD
    at = cycles - xp.floor(cycles)
    begins = at < length
    part = xp.where(begins, at / length, (at - length) / (1 - length))
    return Phase(begins == first, part.astype(time.dtype))


def mode(gait: Gait, now: Phase, contacts: Array) -> Mode:
    """What the legs do, given which feet touch something, (4,) bool; a part's beginning belongs to the clock."""
    heard = now.part >= gait.blind
    early, lost = now.swings & contacts & heard, ~now.swings & ~contacts & heard
    return Mode(~now.swings | early, early, lost)
