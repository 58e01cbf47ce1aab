"""The options that a command line names, read before tyro does; and the refusal of contradictions among them."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator, Sequence

import tyro

from loco_mjx.errors import UserError

_OPTION = re.compile(r"--[A-Za-z]")


def hyphens(word: str) -> str:
    """`--ppo.num_envs=8` and `--ppo.num-envs=8` are the same option."""
    name, equals, value = word.partition("=")
    return name.replace("_", "-") + equals + value if name.startswith("--") else word


IMPORT = "--import"


def imports(args: Sequence[str]) -> list[str]:
    """The modules that a command line imports, in order.

    Raises:
        UserError: if an `--import` names none.
    """
    return [module for module, _ in _split(args) if module is not None]


def without_imports(args: Sequence[str]) -> list[str]:
    """The words of a command line that are the command's own."""
    return [word for module, word in _split(args) if module is None]


def _split(args: Sequence[str]) -> Iterator[tuple[str | None, str]]:
    """The modules that are imported, as (module, ""), and the other words, as (None, word)."""
    left = iter(args)
    for word in left:
        name, equals, value = word.partition("=")
        if name != IMPORT:
            yield None, word
            continue
        module = value if equals else next(left, "")
        if not module or _OPTION.match(module):
            raise UserError(f"{IMPORT} names no module; accepted: a module that Python finds, or a .py file")
        yield module, ""


def given(args: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Each option named, in order, with the words after it up to the next one.

    The words of the last option may include positional arguments: only the options' types could tell them apart.
    """
    found: list[tuple[str, tuple[str, ...]]] = []
    for arg in args:
        if _OPTION.match(arg):
            name, equals, value = hyphens(arg).partition("=")
            found.append((name, (value,) if equals else ()))
        elif found:
            name, values = found[-1]
            found[-1] = name, (*values, arg)
    return found


def refuse_contradictions(kind: type, args: Sequence[str]) -> None:
    """Refuses an option that is given twice with different values: one of them would silently win.

    Args:
        kind: the dataclass of options.
        args: the words of the command line.

    Raises:
        UserError: naming the option and both values.
    """
    free = _takes_free_words(kind)
    before: dict[str, tuple[str, ...]] = {}
    for name, values in given(args):
        first = before.setdefault(name, values)
        shared = min(len(first), len(values)) if free else None  # what goes beyond may be the free word
        if first[:shared] != values[:shared]:
            raise UserError(f"{name} is given twice, as {_shown(first)} and as {_shown(values)}; accepted: once")


def _takes_free_words(kind: type) -> bool:
    """Whether there is a positional argument, as a run's directory."""
    hints = typing.get_type_hints(kind, include_extras=True).values()
    return any(tyro.conf.Positional in getattr(hint, "__metadata__", ()) for hint in hints)


def _shown(values: tuple[str, ...]) -> str:
    return f"'{' '.join(values)}'" if values else "a flag"
