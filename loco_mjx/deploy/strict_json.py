"""JSON as a manifest has it: numbers that are numbers, and every key once."""

from __future__ import annotations

import json
import math
from typing import Any


def parse(text: str) -> Any:
    """JSON, strictly: no NaN, no infinities, no key twice.

    Raises:
        ValueError: saying what is wrong with it.
    """
    try:
        return json.loads(text, parse_constant=_no_number, parse_float=_finite, object_pairs_hook=_each_once)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is no number")


def _finite(digits: str) -> float:
    if not math.isfinite(float(digits)):
        raise ValueError(f"{digits} is too large")
    return float(digits)


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    for i, (key, _) in enumerate(pairs):
        if any(other == key for other, _ in pairs[:i]):
            raise ValueError(f"'{key}' is there twice")
    return dict(pairs)
