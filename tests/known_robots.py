"""The robots that come with the package, as the tests use them."""

from __future__ import annotations

from loco_mjx.robots import get_robot

A1, GO1, GO2 = (get_robot(name) for name in ("a1", "go1", "go2"))
ROBOTS = (A1, GO1, GO2)
