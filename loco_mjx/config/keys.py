"""The keys of a configuration on one level, such as `ppo.clip`, and a configuration with some of them changed."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Union

from loco_mjx.config.controllers import with_controller
from loco_mjx.config.presets import with_robot
from loco_mjx.config.tree import Config
from loco_mjx.config.written import from_dict, to_dict
from loco_mjx.errors import UnknownNameError, UserError
from loco_mjx.ranges import complaint, values

ROBOT, CONTROLLER = "env.robot", "env.controller"


def flatten(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested dictionary as one level, keys joined by dots; tuples become lists, as in JSON."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = list(value) if isinstance(value, tuple) else value
    return flat


def with_keys(config: Config, changes: Iterable[tuple[str, str]]) -> Config:
    """A configuration with the values of some keys changed.

    Args:
        config: to start from.
        changes: pairs of a key and its value in words: `("ppo.clip", "0.1")`; several values are joined by commas.

    Raises:
        UserError: if there is no such key, it has two values, or a value is not accepted.
    """
    given: dict[str, str] = {}
    hints = {path: hint for path, _, hint in values(config)}
    for key, text in changes:
        if given.setdefault(key, text) != text:
            raise UserError(f"{key} is given twice, as {given[key]} and as {text}; accepted: once")
    return with_values(config, {key: _parse(text, hints.get(key, str)) for key, text in given.items()})


def with_values(config: Config, changes: Mapping[str, Any]) -> Config:
    """A configuration with the values of some keys changed.

    Args:
        config: to start from.
        changes: values by key: `{"ppo.clip": 0.1}`.

    Raises:
        UserError: if there is no such key, or a value is not accepted.
    """
    if ROBOT in changes:  # whose own gains the others may then change
        config = with_robot(config, changes[ROBOT])
    if CONTROLLER in changes:  # whose own horizon, sensors and reward likewise
        config = with_controller(config, changes[CONTROLLER])
    tree, known = to_dict(config), [path for path, _, _ in values(config)]
    for key, value in changes.items():
        if key not in known:
            raise UnknownNameError("key", key, known)
        *groups, name = key.split(".")
        table = tree
        for group in groups:
            table = table[group]
        table[name] = value
    return from_dict(Config, tree)


def _parse(text: str, hint: Any) -> Any:
    """The value of a declared type that a word stands for; where it stands for none, the word itself."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return _parse(text, parts[0])
    if origin in (Union, types.UnionType):
        values = [_parse(text, part) for part in parts]
        return next((v for v, part in zip(values, parts, strict=True) if complaint(v, part) is None), text)
    if origin is tuple:
        return tuple(_parse(word.strip(), parts[0]) for word in text.split(","))
    if origin is Literal:
        return next((choice for choice in parts if str(choice) == text), text)
    if hint in (bool, type(None)):
        return {"True": True, "False": False, "None": None}.get(text, text)
    if hint in (int, float):
        try:
            return hint(text)
        except ValueError:
            return text
    return text
