"""Calls that may block or break, made in a thread of their own so that the control loop goes on without them."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

SLICE = 0.01  # s between two looks at what else there is to do


class Overdue(Exception):  # noqa: N818 - it is no error
    """A call has not come back in time."""


class Worker:
    """One daemon thread: a call that never comes back does not keep the process from ending."""

    def __init__(self, name: str) -> None:
        """Starts the thread."""
        self._calls: queue.SimpleQueue[tuple[Callable[[], Any], queue.SimpleQueue[Any]] | None] = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True, name=name).start()

    def post(self, call: Callable[[], Any]) -> queue.SimpleQueue[Any]:
        """Makes a call after those before it; the queue gets (result, exception)."""
        answer: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._calls.put((call, answer))
        return answer

    def call(self, call: Callable[[], Any], patience: float, poll: Callable[[], None] = lambda: None) -> Any:
        """Makes a call and waits for its result.

        Args:
            call: without arguments.
            patience: s to wait.
            poll: called while waiting; what it raises ends the waiting.

        Raises:
            Overdue: if the call has not come back by then. What the call raises is raised here.
        """
        answer, end = self.post(call), time.monotonic() + patience
        while True:
            try:
                result, error = answer.get(timeout=SLICE)
            except queue.Empty:
                poll()
                if time.monotonic() > end:
                    raise Overdue from None
                continue
            if error is not None:
                raise error
            return result

    def close(self) -> None:
        """Ends the thread after the calls before."""
        self._calls.put(None)

    def _work(self) -> None:
        while (posted := self._calls.get()) is not None:
            call, answer = posted
            try:
                answer.put((call(), None))
            except BaseException as error:  # it is raised where the result is waited for
                answer.put((None, error))
