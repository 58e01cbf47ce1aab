"""Lists on the command line: names joined by commas, ranges of seeds."""

from __future__ import annotations

import re

from loco_mjx.errors import UserError

MOST_SEEDS = 1000
_RANGE = re.compile(r"(\d+)(?:-(\d+))?")
_ACCEPTED = "accepted: numbers and ranges joined by commas, e.g. 0-4 or 0,2,5"


def parse_names(text: str, kind: str) -> list[str]:
    """Names joined by commas, each once.

    Raises:
        UserError: if there are none, or one is empty.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UserError(f"'{text}' lists no {kind}, or an empty one; accepted: names joined by commas")
    return list(dict.fromkeys(names))


def parse_seeds(text: str) -> list[int]:
    """Seeds as numbers and ranges joined by commas, ends included: `0-4`, `0,2,5`; each once.

    Raises:
        UserError: if it means nothing, runs backwards, or is more than a sweep can be.
    """
    seeds: dict[int, None] = {}
    for part in text.split(","):
        found = _RANGE.fullmatch(part.strip())
        if found is None:
            raise UserError(f"seeds '{text}' mean nothing at '{part}'; {_ACCEPTED}")
        first, last = int(found[1]), int(found[2] or found[1])
        if last < first:
            raise UserError(f"seeds '{part.strip()}' run backwards; write {last}-{first}")
        if last >= 2**31:
            raise UserError(f"seed is {last}; accepted: 0 to {2**31 - 1}")
        if last - first >= MOST_SEEDS:
            raise UserError(f"seeds '{part.strip()}' are {last - first + 1:,}; accepted: at most {MOST_SEEDS:,}")
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)
