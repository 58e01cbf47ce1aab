"""Values that no option accepts, from the ranges that are declared for it."""

from __future__ import annotations

import importlib
import math
import random
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal

from loco_mjx import ranges
from loco_mjx.ranges import Range

# Whatever an option is, if it is a number or one of several words.
NOWHERE = ("nan", "-nan", "inf", "-inf", "1e999", "-1e999", "banana", "", " ", "1,5", "0x10", "½", "--", "\udcff", "[]")
NO_WHOLE = ("2.5", "1e3", "1e-3", "1.0")
BEYOND = (2**31, 2**63, 2**64, 10**30, 10**400, -1, -(2**63), -(10**30))


@dataclass(frozen=True)
class Option:
    """One option of a command.

    Attributes:
        name: as on the command line, without a value.
        hint: its type.
        kinds: int, float, bool, str or the tuple of words of each value that it takes; None: it takes no such values.
        accepted: the range of each value, where there is one.
    """

    name: str
    hint: Any
    kinds: tuple[Any, ...]
    accepted: tuple[Range | None, ...]

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return bool(self.kinds) and all(kind in (int, float) for kind in self.kinds)


@cache
def options(verb: str) -> tuple[Option, ...]:
    """The options of a command that have numbers, words to choose from, or True and False as values."""
    return tuple(option for option in _options(verb) if option.kinds)


@cache
def names(verb: str) -> tuple[str, ...]:
    """The names of all options of a command."""
    return (*(option.name for option in _options(verb)), *(("--set",) if verb == "sweep" else ()))


def _options(verb: str) -> Iterator[Option]:
    kind = importlib.import_module(f"loco_mjx.cli.{verb}").Options
    for path, hint in ranges.leaves(kind):
        whole = path.removeprefix("loop.").replace("_", "-")
        values = list(_values(hint, None))
        flag = hint is bool and "." not in path  # is given without a value
        yield Option(f"--{whole}", hint, () if flag else tuple(k for k, _ in values), tuple(r for _, r in values))


def _values(hint: Any, declared: Range | None) -> Iterator[tuple[Any, Range | None]]:
    """What each value of an option may be; nothing for paths and text."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint in (int, float, bool):
        yield hint, declared
    elif origin is Literal:
        yield tuple(map(str, parts)), None
    elif origin is Annotated:
        own = next((part for part in parts[1:] if isinstance(part, Range)), None)
        yield from _values(parts[0], own or declared)
    elif origin is tuple:
        yield from (value for part in parts if part is not Ellipsis for value in _values(part, declared))
    elif origin is not None:  # one of several types, mostly None or another
        yield from _values(next(part for part in parts if part is not type(None)), declared)


def refused(option: Option, numbers: random.Random) -> list[str]:
    """Values for an option, one of which it cannot take."""
    wrong = numbers.randrange(len(option.kinds))
    pairs = enumerate(zip(option.kinds, option.accepted, strict=True))
    return [_refused(kind, known, numbers) if i == wrong else _accepted(kind, known) for i, (kind, known) in pairs]


def _refused(kind: Any, known: Range | None, numbers: random.Random) -> str:
    if kind not in (int, float):
        return numbers.choice([*NOWHERE, "7.5", "TRUE?", "truefalse"])
    if numbers.random() < 0.4:
        return numbers.choice([*NOWHERE, *(NO_WHOLE if kind is int else ())])
    assert known is not None  # every number has one: tests/test_ranges.py
    step = 1 if kind is int else None
    low = known.low if known.above else (known.low - 1 if step else math.nextafter(known.low, -math.inf))
    high = known.high if known.below else (known.high + 1 if step else math.nextafter(known.high, math.inf))
    edge = [str(int(value) if step else value) for value in (low, high)]
    return numbers.choice([*edge, *(str(value) for value in BEYOND if value not in known)])


def _accepted(kind: Any, known: Range | None) -> str:
    if kind not in (int, float):
        return "True" if kind is bool else kind[0]
    assert known is not None
    value = min(max(1, known.low), known.high)
    return str(int(value) if kind is int else value)
