"""The configuration as JSON, and back."""

from __future__ import annotations

import dataclasses
import typing
from typing import Any

import numpy as np

from loco_mjx import ranges
from loco_mjx.config.reward_terms import Weights
from loco_mjx.errors import UserError


def to_dict(config: Any) -> dict[str, Any]:
    """A configuration as plain JSON types; the weights of registered terms stand beside the other keys."""
    return _plain(dataclasses.asdict(config))


def _plain(tree: dict[str, Any]) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Weights):
            plain |= value
        else:
            plain[name] = _plain(value) if isinstance(value, dict) else _python(value)
    return plain


def _python(value: Any) -> Any:
    """A value without NumPy's types, which are numbers too, but not JSON's."""
    if isinstance(value, tuple):
        return tuple(map(_python, value))
    return value.item() if isinstance(value, np.generic) else value


def from_dict(kind: type, values: dict[str, Any]) -> Any:
    """Rebuilds a configuration from :func:`to_dict`'s output, and checks its values.

    A missing key, one that a later version brought, takes its default: a new key's default is what was done before.

    Raises:
        UserError: on a key that the configuration does not have, or a value that is not accepted.
    """
    built = _build(kind, values)
    ranges.check(built)
    return built


def _build(kind: type, values: Any) -> Any:
    if not isinstance(values, dict):
        raise UserError(f"{kind.__name__} is {values!r:.40}, not a table of keys")
    hints = typing.get_type_hints(kind)
    names = {f.name for f in dataclasses.fields(kind)}
    terms = next((name for name in names if hints[name] is Weights), None)
    if terms is not None:  # what is there counts, not what is registered by now; whoever computes them knows the names
        own = names - {terms}
        values = {name: value for name, value in values.items() if name in own} | {
            terms: Weights({name: value for name, value in values.items() if name not in own})
        }
    if not names >= set(values):
        raise UserError(f"{kind.__name__} has no keys {sorted(set(values) - names)} in this version")
    built = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    for name in names:
        if dataclasses.is_dataclass(hints[name]):
            built[name] = _build(hints[name], values.get(name, {}))  # type: ignore[arg-type]
    return kind(**built)
