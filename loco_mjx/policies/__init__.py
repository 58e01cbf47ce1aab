"""Policies that come with the package, by name: folders as `loco-mjx export` writes them.

`evaluate`, `play`, `simcheck`, `export` and `deploy` take a name wherever they take a folder of the user's own.
`experiments/ship.py` writes them; docs/results.md says how they were trained.
Their figures are in their `policy.json`.
"""

from __future__ import annotations

from pathlib import Path

from loco_mjx.deploy.folder import MANIFEST

SHIPPED = Path(__file__).parent


def names() -> tuple[str, ...]:
    """The names of all policies that come with the package, sorted."""
    return tuple(sorted(entry.parent.name for entry in SHIPPED.glob(f"*/{MANIFEST}")))


def find(given: Path) -> Path:
    """The folder that is meant: the user's own if it exists, else the shipped one of that name, else what was given."""
    return SHIPPED / given if not given.exists() and str(given) in names() else given
