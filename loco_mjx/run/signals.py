"""Ctrl-C, SIGTERM and a terminal that is closed, as a request that the loop reads between iterations."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE = 1.0  # s, within which Python sees a signal unless it waits for something such as the compiler
_STOPPING = "stopping after this iteration, then saving (Ctrl-C again: leave at once)"
_LEAVING = "stopped before the first iteration was done: there is nothing new to save"


class Interrupt:
    """While entered, Ctrl-C raises KeyboardInterrupt as ever, but is remembered.

    Whatever runs when it comes, such as a callback of a library, may swallow the exception.
    """

    def __init__(self) -> None:
        self.came = False

    def __enter__(self) -> Interrupt:
        self._installed = _in_main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if self._installed:
            signal.signal(signal.SIGINT, self)
        return self

    def __exit__(self, *_: object) -> None:
        if self._installed:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        """What Python calls."""
        self.came = True
        raise KeyboardInterrupt


class Leave(KeyboardInterrupt):
    """The first signal came while there was nothing to save."""


class Stop:
    """While entered, the first signal sets `signal`; a second Ctrl-C interrupts at once.

    A process that compiles sees no signal for as long as that takes. Where nothing is lost by it, or Ctrl-C came twice,
    it is then ended from another thread.

    Attributes:
        signal: the signal that came, or None.
        can_leave: whether there is nothing to save yet, so that the first signal raises `Leave`.
    """

    def __init__(
        self, say: Callable[[str], None], can_leave: bool = False, farewell: Callable[[], None] = print
    ) -> None:
        """Prepares it.

        Args:
            say: prints a line.
            can_leave: see above.
            farewell: called before the process is ended from another thread.
        """
        self.signal: int | None = None
        self.can_leave = can_leave
        self._say, self._farewell = say, farewell
        self._before: dict[int, Any] = {}
        self._seen = -float("inf")  # when Python last saw a signal
        self._told = False
        self._pipe: tuple[int, int] | None = None

    def __enter__(self) -> Stop:
        # Only the main thread may set handlers; elsewhere whoever runs the loop keeps its own.
        if not _in_main_thread():
            return self
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # as below `nohup`
                self._before[number] = signal.signal(number, self._handle)
        earlier = self._before[signal.SIGINT]
        if isinstance(earlier, Interrupt) and earlier.came:
            self._restore()
            raise KeyboardInterrupt
        self._watch()
        return self

    def __exit__(self, *_: object) -> None:
        if self._pipe is not None:
            signal.set_wakeup_fd(-1)
            os.close(self._pipe[1])  # which ends the thread
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._seen = time.monotonic()
        again, self.signal = self.signal is not None, self.signal or number
        if again and number == signal.SIGINT:
            raise KeyboardInterrupt
        if self.can_leave and not again:
            raise Leave
        self._tell()

    def _tell(self) -> None:
        if not self._told:
            self._told = True
            with contextlib.suppress(RuntimeError):  # the signal came while something was being printed
                self._say(_STOPPING)

    def _watch(self) -> None:
        """Has a thread see the signals, too, unless somebody else does already."""
        read, write = os.pipe()
        os.set_blocking(write, False)
        other = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        if other != -1:
            signal.set_wakeup_fd(other)
            os.close(read)
            os.close(write)
            return
        self._pipe = read, write
        threading.Thread(target=self._watch_pipe, args=(read,), daemon=True).start()

    def _watch_pipe(self, read: int) -> None:
        count = 0
        while data := os.read(read, 1):
            number = data[0]
            if number not in self._before:
                continue
            count += 1
            came = time.monotonic()
            while time.monotonic() - came < PATIENCE and self._seen < came - PATIENCE:
                time.sleep(PATIENCE / 20)
            if self._seen >= came - PATIENCE:
                continue
            if self.can_leave or (count > 1 and number == signal.SIGINT):
                self._end(number)
            self._tell()
        os.close(read)

    def _end(self, number: int) -> NoReturn:
        with contextlib.suppress(OSError, RuntimeError):
            self._say(_LEAVING if self.can_leave else "stopped at once")
            self._farewell()
            sys.stdout.flush()
        os._exit(128 + number)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
