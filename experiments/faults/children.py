"""Processes that run the real command, to be killed or to run out of disk."""

from __future__ import annotations

import multiprocessing
import os
import resource
import subprocess
import sys
from multiprocessing.process import BaseProcess
from pathlib import Path

from tests.run import child

ROOT = Path(__file__).parents[2]
CORES, SECONDS = "1", "60"  # see tests/run/child.py
# Forked from a process that has imported what takes seconds, and has started nothing.
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["experiments.faults.training", "loco_mjx.env", "loco_mjx.cli.main", "tests.run.child"])


def started(words: list[str], limit: int | None = None) -> subprocess.Popen[str]:
    """A process of its own from its first import on; with a limit no file of it grows beyond so many bytes."""
    program = [sys.executable, "-m", "tests.run.child", CORES, SECONDS, *words]
    ulimit = None if limit is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    return subprocess.Popen(
        program, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=ulimit
    )


def forked(words: list[str]) -> BaseProcess:
    """One whose imports are done."""
    process = _SERVER.Process(target=_run, args=(words,))
    process.start()
    return process


def _run(words: list[str]) -> None:
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silent, stream)
    sys.argv = [child.__file__, CORES, SECONDS, *words]
    sys.exit(child.main())
