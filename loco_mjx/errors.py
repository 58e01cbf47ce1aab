"""The errors a user can cause; the command line prints them as one line and exits with 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UserError(ValueError):
    """A mistake in what the user asked for: one line that names it and what is accepted."""


class UnknownNameError(UserError):
    """A name that no registry holds."""

    def __init__(self, kind: str, name: str, accepted: Iterable[str]) -> None:
        names = sorted(accepted)
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        super().__init__(f"unknown {kind} '{name}'{hint}; accepted: {', '.join(names)}")
