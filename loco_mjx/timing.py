"""How long a compiled call takes."""

from __future__ import annotations

import time
from collections.abc import Callable
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
