"""How long a compiled call takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax


class Rolling:
    """A call that hands its result to the next one.

    Attributes:
        state: the last result.
    """

    def __init__(self, step: Callable[[Any], Any], state: Any) -> None:
        self.step, self.state = step, state

    def __call__(self) -> Any:
        """The next result."""
        self.state = self.step(self.state)
        return self.state


def seconds_per_call(call: Callable[[], Any], seconds: float, least: int = 2) -> float:
    """Mean duration of a call whose result is waited for, over at least so many seconds and calls."""
    begin, calls = time.monotonic(), 0
    while calls < least or time.monotonic() - begin < seconds:
        jax.block_until_ready(call())
        calls += 1
    return (time.monotonic() - begin) / calls


def seconds_in_turn(calls: Sequence[tuple[Callable[[], Any], int]], seconds: float, least: int = 3) -> list[float]:
    """Mean duration of each of several calls, measured in turn: a machine whose speed drifts slows all of them.

    Args:
        calls: what to call, and how often in a round.
        seconds: to measure for, at least, all of them together.
        least: rounds, at least.
    """
    spent, rounds = [0.0] * len(calls), 0
    while rounds < least or sum(spent) < seconds:
        for i, (call, times) in enumerate(calls):
            spent[i] += times * seconds_per_call(call, 0.0, times)
        rounds += 1
    return [total / (rounds * times) for total, (_, times) in zip(spent, calls, strict=True)]
