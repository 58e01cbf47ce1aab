"""The configuration as JSON, and back."""

from __future__ import annotations

import dataclasses
import typing
from typing import Any

from loco_mjx import ranges
from loco_mjx.errors import UserError


def to_dict(config: Any) -> dict[str, Any]:
    """A configuration as plain JSON types."""
    return dataclasses.asdict(config)


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
    if not names >= set(values):
        raise UserError(f"{kind.__name__} has no keys {sorted(set(values) - names)} in this version")
    built = {}
    for name, value in values.items():
        hint = hints[name]
        if dataclasses.is_dataclass(hint):
            value = _build(hint, value)  # type: ignore[arg-type]
        elif isinstance(value, list):
            value = tuple(value)
        built[name] = value
    return kind(**built)
