"""One runner per robot: a file that the kernel keeps locked for as long as its process lives."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from loco_mjx.errors import UserError

FOLDER = Path("/tmp")  # whoever runs it, with whatever TMPDIR


class Lock:
    """Held from its construction to `release`, or to the process' end, however it comes."""

    def __init__(self, robot: str) -> None:
        """Takes the lock.

        Args:
            robot: its name, which is that of the file.

        Raises:
            UserError: if another runner has it, or the file cannot be made.
        """
        path = FOLDER / f"loco-mjx-{robot}.lock"
        try:
            self._file = _open(path)
        except OSError as error:
            raise UserError(f"cannot lock the robot with {path}: {error.strerror or error}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self.release()
            raise UserError(f"another runner has the robot {robot} ({path} is locked); end it first") from error

    def release(self) -> None:
        """Lets another runner have the robot."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _open(path: Path) -> int:
    """The file, made if there is none; another user's can be locked without the right to write it."""
    try:
        return os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)
