"""The README's pictures of a run, docs/walking.gif and docs/attention.png: `python -m experiments.pictures RUN`."""

from __future__ import annotations

import sys

from loco_mjx.cli.main import main

GIF = ["--video", "docs/walking.gif", "--width", "320", "--fps", "12.5"]
FIGURE = ["--figure", "docs/attention.png", "--columns", "5"]


def pictures(run: str) -> int:
    """Films the first scene for 8 s, and draws 5 moments of it; replaces what is there."""
    return main(["play", run, *GIF, *FIGURE, "--seconds", "8", "--attention", "--overwrite"])


if __name__ == "__main__":
    sys.exit(pictures(*sys.argv[1:2]))
