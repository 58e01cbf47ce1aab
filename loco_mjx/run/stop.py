"""Ctrl-C and SIGTERM as a request that the loop reads between iterations."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any


class Stop:
    """While entered, the first signal sets `signal`; a second Ctrl-C interrupts at once.

    Attributes:
        signal: the signal that came, or None.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        """Args: say: prints a line."""
        self.signal: int | None = None
        self._say = say
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Stop:
        # Only the main thread may set handlers; elsewhere whoever runs the loop keeps its own.
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.signal = number
        self._say("stopping after this iteration, then saving (Ctrl-C again: leave at once)")
