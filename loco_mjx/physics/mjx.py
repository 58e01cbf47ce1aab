"""MJX, imported without the lines on stdout that tell of a renderer which is not installed and not used here."""

from __future__ import annotations

import contextlib
import io

_said = io.StringIO()
with contextlib.redirect_stdout(_said):
    from mujoco import mjx
for _line in _said.getvalue().splitlines():
    if not _line.startswith("Failed to import"):
        print(_line)

__all__ = ["mjx"]
