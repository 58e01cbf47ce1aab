"""What a value may be: declared beside each field of a dataclass, and checked here alone.

``discount: Annotated[float, Range(0, 1)] = 0.99`` declares a range. Of NaN and of the infinities none is in any range.
"""

from __future__ import annotations

import dataclasses
import numbers
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, Literal, Union

from loco_mjx.errors import UserError

LONGEST = 160  # characters that are shown of a value


@dataclass(frozen=True)
class Range:
    """The numbers that are accepted.

    Attributes:
        low: the lowest.
        high: the highest.
        above: only what is more than `low`.
        below: only what is less than `high`.
    """

    low: float
    high: float
    above: bool = False
    below: bool = False

    def __contains__(self, value: float) -> bool:
        """Whether a number is accepted; NaN is not, for it compares with nothing."""
        low = self.low < value if self.above else self.low <= value
        return bool(low and (value < self.high if self.below else value <= self.high))

    def __str__(self) -> str:
        low, high = _plain(self.low), _plain(self.high)
        if not self.above and not self.below:
            return f"{low} to {high}"
        return f"{'more than ' if self.above else ''}{low}, {'less than' if self.below else 'up to'} {high}"


@dataclass(frozen=True)
class Each:
    """That every value of a mapping is of a type.

    Attributes:
        hint: the type, with its ranges.
    """

    hint: Any


SEED = Annotated[int, Range(0, 2**31 - 1)]
COUNT = Annotated[int, Range(1, 1_000_000)]  # of episodes and the like


def check(tree: Any, prefix: str = "", called: Callable[[str], str] = str) -> None:
    """Checks the type and the range of every value in a dataclass and those it holds.

    Args:
        tree: the dataclass.
        prefix: of the values' names, such as "limits".
        called: from a value's path, such as ``ppo.clip``, to what messages call it.

    Raises:
        UserError: naming the first value that is not accepted, and what is.
    """
    for path, value, hint in values(tree):
        accepted = complaint(value, hint)
        if accepted is not None:
            name = f"{prefix}.{path}" if prefix else called(path)
            raise UserError(f"{name} is {_shown(value)}; accepted: {accepted}")


def values(tree: Any) -> Iterator[tuple[str, Any, Any]]:
    """Path, value and type of every value in a dataclass and those it holds, and in the mappings of values by name."""
    for path, hint in leaves(type(tree)):  # type: ignore[arg-type]
        yield from _values(path, attrgetter(path)(tree), hint)


def _values(path: str, value: Any, hint: Any) -> Iterator[tuple[str, Any, Any]]:
    """A leaf's path, value and type; of a mapping those of its values, which stand beside the mapping."""
    each = next((part.hint for part in getattr(hint, "__metadata__", ()) if isinstance(part, Each)), None)
    if each is None:
        yield path, value, hint
        return
    if not isinstance(value, Mapping):
        yield path, value, Mapping
        return
    group = path.rpartition(".")[0]
    for name, one in value.items():
        yield f"{group}.{name}" if group else name, one, each


@cache
def leaves(kind: type) -> tuple[tuple[str, Any], ...]:
    """Path and type of every value in a kind of dataclass and those it holds: ``("ppo.clip", float)``."""
    return tuple(_leaves(kind, ""))


def _leaves(kind: type, prefix: str) -> Iterator[tuple[str, Any]]:
    hints = typing.get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        hint = hints[field.name]
        bare = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
        if dataclasses.is_dataclass(bare):
            yield from _leaves(bare, f"{prefix}{field.name}.")  # type: ignore[arg-type]
        else:
            yield prefix + field.name, hint


def complaint(value: Any, hint: Any) -> str | None:
    """What a type with its ranges accepts, if it does not accept the value; None if it does.

    Types other than numbers, words, choices and tuples of them accept everything.
    """
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        declared = [part for part in parts[1:] if isinstance(part, Range)]
        wrong = complaint(value, parts[0])
        if wrong is not None:
            return ", ".join([wrong, *map(str, declared)])
        return next((str(part) for part in declared if value is not None and value not in part), None)
    if origin in (Union, types.UnionType):
        wrongs = [complaint(value, part) for part in parts]
        return None if None in wrongs else " or ".join(wrong for wrong in wrongs if wrong)
    if origin is Literal:
        return None if (type(value), value) in [(type(one), one) for one in parts] else ", ".join(map(str, parts))
    if origin is tuple:
        return _complaint_of_tuple(value, parts)
    kinds: dict[Any, tuple[Any, str]] = {
        bool: (bool, "True or False"),
        int: (numbers.Integral, "a whole number"),
        float: (numbers.Real, "a number"),
        str: (str, "a word"),
        type(None): (type(None), "None"),
        Mapping: (Mapping, "values by name"),
    }
    if hint not in kinds:
        return None
    kind, name = kinds[hint]
    return None if isinstance(value, kind) and (hint is bool or not isinstance(value, bool)) else name


def _complaint_of_tuple(value: Any, parts: tuple[Any, ...]) -> str | None:
    many = len(parts) == 2 and parts[1] is Ellipsis
    if not isinstance(value, tuple) or not (many or len(value) == len(parts)):
        return "several values" if many else f"{len(parts)} values"
    wrongs = (complaint(one, parts[0] if many else part) for one, part in zip(value, parts * len(value), strict=False))
    return next((f"each {wrong}" for wrong in wrongs if wrong is not None), None)


def _shown(value: Any) -> str:
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= LONGEST else text[:LONGEST] + " …"


def _plain(number: float) -> str:
    return str(int(number)) if number == int(number) else str(number)
