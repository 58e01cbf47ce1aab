"""Reads a command line with tyro; what tyro lets pass is then checked: contradictions, and values out of range."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import typing
from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

from loco_mjx import ranges
from loco_mjx.cli import page, words
from loco_mjx.cli.options import REGISTRY

T = TypeVar("T")


def parse(
    kind: type[T],
    args: Sequence[str],
    prog: str,
    default: T | None = None,
    names: Sequence[str] = (),
    keys: Sequence[str] = (),
) -> T:
    """Fills a dataclass from the command line; one option per field, nested fields joined by dots.

    Args:
        kind: the dataclass.
        args: the words of the command line.
        prog: the command, for its help.
        default: an instance whose values are the defaults.
        names: kinds of names that the help lists: "tasks", "robots", "policies", "presets".
        keys: fields, each a dataclass, whose options only `--help-all` lists; they need a default.

    Raises:
        UserError: on a value beyond its declared range, and on an option with two values.
        SystemExit: with code 0, after printing the help; with 2 where tyro has said what it does not accept.
    """
    args = words.without_imports(args)  # loaded by now
    if page.asked(args):
        _help(kind, prog, default, names, keys, page.ALL in args)
    words.refuse_contradictions(kind, args)
    filled = _filled(kind, args, prog, default, keys)
    ranges.check(filled, called=_called)
    return filled


def _called(path: str) -> str:
    """A key of the configuration as it is written there, an option as on the command line."""
    path = path.removeprefix("loop.")  # whose options stand beside the command's own
    return path if "." in path else path.replace("_", "-")


def _help(
    kind: type[T], prog: str, default: T | None, names: Sequence[str], keys: Sequence[str], everything: bool
) -> NoReturn:
    """Prints the help, all of it or without the keys of a configuration."""
    said = page.description(kind, names, keys, everything)
    if keys and default is not None and not everything:
        kind, default = page.brief(kind, default, keys)
    _tyro(kind, ["--help"], prog, default, said)
    raise SystemExit(0)


def _filled(kind: type[T], args: Sequence[str], prog: str, default: T | None, keys: Sequence[str]) -> T:
    """As :func:`_tyro`, which looks only at those keys of a configuration of which the command line names one.

    To read the types of all of them takes longer than everything else does. Where that does not do, all are looked at:
    what is said then knows every option.
    """
    named = {name.removeprefix("--").partition(".")[0] for name, _ in words.given(args)}
    left = frozenset(keys) - named
    if default is None or not left:
        return _tyro(kind, args, prog, default)
    values = {field.name: getattr(default, field.name) for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    lean = _without(kind, left)  # type: ignore[arg-type]
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            found = _tyro(lean, args, prog, lean(**{name: values[name] for name in values.keys() - left}))
    except SystemExit:
        return _tyro(kind, args, prog, default)
    return kind(**values | {name: getattr(found, name) for name in values.keys() - left})


@functools.cache
def _without(kind: type, left: frozenset[str]) -> Any:
    """A dataclass with the other fields."""
    hints = typing.get_type_hints(kind, include_extras=True)
    fields = [(field.name, hints[field.name]) for field in dataclasses.fields(kind) if field.name not in left]
    return dataclasses.make_dataclass(kind.__name__, fields, frozen=True)


def _tyro(kind: type[T], args: Sequence[str], prog: str, default: T | None, description: str | None = None) -> T:
    import tyro

    text = [words.hyphens(word) for word in args]
    more: dict[str, Any] = {} if default is None else {"default": default}
    with REGISTRY:
        return tyro.cli(
            kind, args=text, prog=prog, description=description, config=(tyro.conf.FlagCreatePairsOff,), **more
        )
