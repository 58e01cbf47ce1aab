"""Names and what they stand for: tasks, policies and terms of the reward, our own and the user's alike."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from types import FrameType
from typing import TypeVar

from loco_mjx.errors import UnknownNameError, UserError

T = TypeVar("T")

PACKAGE = "loco_mjx"
IMPORTED_AS = "__imported_as__"  # in a module that `--import` loaded from a path: that path, as it was given
INTERACTIVE = "__main__"  # the origin of what a notebook or a prompt registers
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # what a directory may be called, and no list or variant splits


class Registry(Mapping[str, T]):
    """Entries by name, in the order in which they came.

    Attributes:
        kind: what messages call an entry: "task".
    """

    def __init__(
        self, kind: str, names: re.Pattern[str] = NAME, accepted: str = "letters, digits, '.', '_' and '-'"
    ) -> None:
        """Starts without entries.

        Args:
            kind: what messages call an entry.
            names: what a name has to match as a whole.
            accepted: the same in words.
        """
        self.kind, self._names, self._accepted = kind, names, accepted
        self._entries: dict[str, T] = {}
        self._origins: dict[str, str | None] = {}

    def register(self, name: str, entry: T, origin: str | None) -> None:
        """Adds an entry; what a notebook registered it may register again.

        Args:
            name: of the entry.
            entry: what the name stands for.
            origin: the module that brings it, from :func:`caller`.

        Raises:
            UserError: if the name is taken or no name.
        """
        if not isinstance(name, str) or self._names.fullmatch(name) is None:
            raise UserError(f"'{name}' is no name of a {self.kind}; accepted: {self._accepted}")
        if name in self._entries and not origin == self._origins[name] == INTERACTIVE:
            owner = self._origins[name] or PACKAGE
            raise UserError(f"there is a {self.kind} '{name}' already, of {owner}; choose another name")
        self._entries[name], self._origins[name] = entry, origin

    def unregister(self, name: str) -> None:
        """Takes an entry out again.

        Raises:
            UnknownNameError: if there is none.
        """
        self.find(name)
        del self._entries[name], self._origins[name]

    def find(self, name: str) -> T:
        """The entry of that name.

        Raises:
            UnknownNameError: if there is none.
        """
        if name not in self._entries:
            raise UnknownNameError(self.kind, name, self._entries)
        return self._entries[name]

    def origin(self, name: str) -> str | None:
        """The module or file that `--import` takes for an entry; None for our own and for unknown names."""
        return self._origins.get(name)

    def __getitem__(self, name: str) -> T:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


def caller(depth: int = 1) -> str | None:
    """What `--import` takes to run the code that called: None for this package's own, INTERACTIVE for a notebook.

    Of a module that a file of `--import` imports it is that file, beside which alone Python may find the module.

    Args:
        depth: 1: whoever called the function that calls this one; 2: whoever called that, and so on.
    """
    frame: FrameType | None = sys._getframe(depth + 1)
    assert frame is not None
    names = frame.f_globals
    name = str(names.get("__name__", ""))
    if name.partition(".")[0] == PACKAGE:
        return None
    if name != "__main__":
        while frame is not None and IMPORTED_AS not in frame.f_globals:
            frame = frame.f_back
        return name if frame is None else str(frame.f_globals[IMPORTED_AS])
    spec, file = names.get("__spec__"), names.get("__file__")
    return spec.name if spec is not None else str(file) if file else INTERACTIVE
