"""The help of a command: the names that it accepts, then its own options; a configuration's keys on request."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import textwrap
from collections.abc import Sequence
from typing import Any, TypeVar

import tyro

T = TypeVar("T")

ALL = "--help-all"
WIDTH = 78
IMPORT = "--import MODULE, as often as needed, loads a module or a .py file of yours first (docs/extending.md)."


def asked(args: Sequence[str]) -> bool:
    """Whether the words ask for help of either length."""
    return any(arg in ("-h", "--help", ALL) for arg in args)


def brief(kind: type[T], default: T, keys: Sequence[str]) -> tuple[type[T], T]:
    """A copy of a dataclass, and its defaults, without some of the fields: for the short help.

    Args:
        kind: the dataclass of options.
        default: an instance of it.
        keys: the fields to leave out; each holds a dataclass.
    """
    values = {f.name: getattr(default, f.name) for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    hidden: dict[str, Any] = {key: tyro.conf.Suppress[type(values[key])] for key in keys}  # type: ignore[misc]
    body = {key: dataclasses.field(default_factory=type(values[key])) for key in keys}
    body |= {"__annotations__": hidden, "__doc__": kind.__doc__, "__module__": kind.__module__}
    made: Any = dataclasses.dataclass(frozen=True)(type(kind.__name__, (kind,), body))
    return made, made(**values)


def description(kind: type, names: Sequence[str], keys: Sequence[str], everything: bool) -> str:
    """The text above the options: what the command does, the names it accepts, where its other options are.

    Args:
        kind: the dataclass of options; its docstring comes first.
        names: kinds of names to list, of "tasks", "robots", "policies" and "presets".
        keys: fields that are left out of the short help.
        everything: whether this is the long help.
    """
    parts = [inspect.getdoc(kind) or ""]
    parts.append(IMPORT)
    if keys and not everything:
        groups = ", ".join(f"--{key}.*" for key in keys)
        parts.append(f"With {ALL} they are listed too: {groups}.")
    text = "\n\n".join(parts)
    with contextlib.suppress(ModuleNotFoundError):  # help needs no extra
        text = "\n".join([text, "", *map(_listed, names)] if names else [text])
    return text


def _listed(kind: str) -> str:
    start = f"  {kind + ':':<11}"  # indented: tyro joins other lines, and sets these apart
    return textwrap.fill(start + ", ".join(_names(kind)), WIDTH, subsequent_indent=" " * len(start))


def _names(kind: str) -> list[str]:
    """The names of a registry; imported here, for the registries bring JAX and help should not wait for it."""
    if kind == "tasks":
        from loco_mjx.scene.tasks import TASKS

        return list(TASKS)
    if kind == "policies":
        from loco_mjx.networks.registry import POLICIES

        return list(POLICIES)
    if kind == "robots":
        from loco_mjx.robots import ROBOTS

        return list(ROBOTS)
    from loco_mjx.config import PRESETS

    return list(PRESETS)
