"""Text from and to terminals that do not have every character."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence

from loco_mjx.errors import UserError


def print_anything() -> None:
    """Has stdout write what its encoding lacks, such as × in ASCII, as an escape instead of raising."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def check_text(words: Sequence[str]) -> None:
    """Refuses words whose bytes cannot be decoded: such a path cannot be printed, nor written into a file.

    Raises:
        UserError: showing the first such word.
    """
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            raise UserError(f"{word!a} is no text in {sys.getfilesystemencoding()}; accepted: text") from None
