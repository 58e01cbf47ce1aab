"""What a run ran with: versions, devices, commit, command."""

from __future__ import annotations

import platform
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import loco_mjx

PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "flax", "optax", "orbax-checkpoint", "numpy")


def versions() -> dict[str, str]:
    """Versions of Python, loco-mjx and the packages that a run's numbers depend on."""
    found = {"python": platform.python_version(), "loco-mjx": loco_mjx.__version__}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def devices() -> dict[str, Any]:
    """Platform, kind and number of the devices JAX sees."""
    import jax

    first = jax.devices()[0]
    return {"platform": first.platform, "kind": first.device_kind, "count": jax.device_count()}


def git() -> dict[str, Any]:
    """Commit of the checkout the package runs from, and whether it has changes; None for both outside of one."""
    root = Path(loco_mjx.__file__).resolve().parents[1]
    commit = _git(root, "rev-parse", "HEAD") if (root / "pyproject.toml").is_file() else None
    changes = _git(root, "status", "--porcelain") if commit else None
    return {"commit": commit, "dirty": None if changes is None else bool(changes)}


def _git(root: Path, *words: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def describe(command: list[str] | None = None) -> dict[str, Any]:
    """Time, command, versions, devices, commit and machine.

    Args:
        command: the command line; None takes the process's own.
    """
    return {
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "command": list(sys.argv if command is None else command),
        "versions": versions(),
        "devices": devices(),
        "git": git(),
        "machine": {"system": platform.platform(), "processor": platform.machine()},
    }
