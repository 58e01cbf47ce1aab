"""The errors a user can cause; the command line prints them as one line and exits with their code."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable
from typing import ClassVar

FULL = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file would be larger than allowed",
}


class UserError(ValueError):
    """A mistake in what the user asked for: one line that names it and what is accepted.

    Attributes:
        code: the exit code of a command that ends with it.
    """

    code: ClassVar[int] = 2


class RunError(UserError):
    """What ended a command that was rightly asked for, such as a full disk; where it is mended the same one goes on."""

    code: ClassVar[int] = 1


class UnknownNameError(UserError):
    """A name that no registry holds."""

    def __init__(self, kind: str, name: str, accepted: Iterable[str]) -> None:
        names = sorted(accepted)
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        super().__init__(f"unknown {kind} '{name}'{hint}; accepted: {', '.join(names)}")


def is_full(error: OSError) -> bool:
    """Whether the disk was full, or would take no more of this user."""
    return error.errno in FULL


def unwritable(what: object, error: OSError, otherwise: str) -> UserError:
    """The error for something that could not be written.

    Args:
        what: such as a path.
        error: of the system.
        otherwise: what to do about anything but a full disk, such as 'choose a writable directory'.
    """
    if error.errno in FULL:
        return RunError(f"cannot write {what}: {FULL[error.errno]}; make room, and the same command goes on")
    return UserError(f"cannot write {what}: {error.strerror or error}; {otherwise}")
