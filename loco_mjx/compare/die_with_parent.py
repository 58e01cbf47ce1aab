"""Runs a command that ends when its parent does: ``python -m loco_mjx.compare.die_with_parent PARENT COMMAND...``.

A sweep that is killed, or a cluster's worker, can stop nothing any more. What it started would train on by itself and
keep whoever comes next out of the run's directory. On Linux the kernel sends it SIGTERM instead, on which it saves;
other systems have no such thing, and there the command runs as it is.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

PR_SET_PDEATHSIG = 1  # prctl(2); it outlives the exec below


def dying_with_parent(command: Sequence[str]) -> list[str]:
    """A command, to be started by this process and to end with it."""
    return [sys.executable, "-m", __name__, str(os.getpid()), *command]


def main(args: Sequence[str]) -> None:
    """Becomes the command."""
    parent, *command = args
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(parent):  # gone before the kernel was told
            sys.exit(128 + signal.SIGTERM)
    os.execvp(command[0], command)


if __name__ == "__main__":
    main(sys.argv[1:])
