"""The curves of a run as TensorBoard reads them.

tensorboardX's own writer has a thread that dies of a full disk, after which the next metrics wait for it for ever; here
its records are written by whoever calls, who meets the error.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FLUSH_SECONDS = 30.0
_VERSION = "brain.Event:2"


class Events:
    """Appends metrics to a file of its own in a directory."""

    def __init__(self, directory: Path, purge_step: int | None) -> None:
        """Begins a file.

        Args:
            directory: of all event files of a run.
            purge_step: the step from which on older files' metrics are hidden; None: none.

        Raises:
            OSError: if it cannot be written.
        """
        from tensorboardX.proto import event_pb2
        from tensorboardX.record_writer import RecordWriter

        self._event = event_pb2.Event
        directory.mkdir(parents=True, exist_ok=True)
        self._writer = RecordWriter(str(_unused(directory)))
        try:
            self._write(file_version=_VERSION)
            if purge_step is not None:
                self._write(step=purge_step, file_version=_VERSION)
                start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
                self._write(step=purge_step, session_log=start)
            self._flush()
        except OSError:
            self.abandon()
            raise

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Appends the metrics of a step.

        Raises:
            OSError: if the disk is full.
        """
        from tensorboardX.proto.summary_pb2 import Summary

        values = [Summary.Value(tag=name, simple_value=float(value)) for name, value in metrics.items()]
        self._write(step=step, summary=Summary(value=values))
        if time.monotonic() - self._flushed >= FLUSH_SECONDS:
            self._flush()

    def close(self) -> None:
        """Puts everything on the disk.

        Raises:
            OSError: if it is full.
        """
        self._flush()
        self._writer.close()

    def abandon(self) -> None:
        """Closes the file, with whatever is in it."""
        with contextlib.suppress(OSError):
            self._writer.close()

    def _write(self, **content: Any) -> None:
        self._writer.write(self._event(wall_time=time.time(), **content).SerializeToString())

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        self._writer.flush()


def _unused(directory: Path) -> Path:
    """A name that TensorBoard knows for one of its files; two starts within a second have different ones."""
    name = f"events.out.tfevents.{int(time.time()):010d}.{socket.gethostname()}"
    number = 0
    while (path := directory / (name + (f".{number}" if number else ""))).exists():
        number += 1
    return path
