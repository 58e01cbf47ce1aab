"""What is said of a mistake: that it names what is wrong and what is accepted, in whatever sentence."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from loco_mjx.errors import UserError


def clear(err: str) -> bool:
    """Whether stderr holds one line of ours, or what tyro says of an option, which ends with where the help is."""
    return "Traceback" not in err and (len(err.splitlines()) == 1 or "--help" in err)


def says(text: str, words: str) -> bool:
    """Whether a text names each of some words (values, options, paths, names), in any order."""
    return all(re.search(rf"(?<![\w.]){re.escape(word)}(?!\w|\.\d)", text) for word in words.split())


@contextmanager
def refusal(words: str, of: type[Exception] = UserError) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """Something in it is refused, with a message that names each of these words."""
    with pytest.raises(of) as raised:
        yield raised
    assert says(str(raised.value), words), f"{words!r} not all in: {raised.value}"
