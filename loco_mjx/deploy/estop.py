"""The emergency stop: a signal or a key ends the run, and the robot sits down."""

from __future__ import annotations

import contextlib
import select
import signal
import sys
from collections.abc import Iterator
from types import FrameType

from loco_mjx.deploy.safety import Cause, Stop


class EmergencyStop:
    """Set by a signal (Ctrl-C, SIGTERM, SIGHUP, SIGUSR1) or by Enter on a terminal; once set it stays."""

    def __init__(self) -> None:
        self.by: str | None = None

    def press(self, by: str) -> None:
        """Sets it."""
        self.by = self.by or by

    def _signalled(self, number: int, frame: FrameType | None) -> None:
        self.press(signal.Signals(number).name)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listens to signals; outside of the main thread Python does not allow it and only the key is left."""
        before: dict[int, object] = {}
        with contextlib.suppress(ValueError):
            for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
                before[name] = signal.signal(name, self._signalled)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)  # type: ignore[arg-type]

    def poll(self) -> None:
        """Looks whether Enter was pressed.

        Raises:
            Stop: if it is set.
        """
        with contextlib.suppress(OSError, ValueError):
            if sys.stdin is not None and sys.stdin.isatty() and select.select([sys.stdin], [], [], 0)[0]:
                sys.stdin.readline()
                self.press("Enter")
        if self.by is not None:
            raise Stop(Cause.ESTOP, self.by)
