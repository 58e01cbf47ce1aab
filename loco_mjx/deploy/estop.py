"""The emergency stop: a signal or a key ends the run, and the robot sits down."""

from __future__ import annotations

import contextlib
import select
import signal
import sys
from collections.abc import Iterator
from types import FrameType

from loco_mjx.deploy.safety import Cause, Stop

# Of Ctrl-C, Ctrl-backslash, Ctrl-Z, of a terminal that is gone, and others: none may leave a robot standing.
SIGNALS = (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP, signal.SIGHUP, signal.SIGTERM, signal.SIGUSR1)


class EmergencyStop:
    """Set by one of SIGNALS, such as Ctrl-C, or by Enter on a terminal; once set it stays."""

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
            for name in SIGNALS:
                before[name] = signal.signal(name, self._signalled)
            # Where the process is in the background, to read the key fails, instead of stopping the process.
            before[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
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
