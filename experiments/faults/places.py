"""Folders, their content, and disks that can be filled."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

DISK_BYTES = 4_000_000


def content(folder: Path) -> dict[str, bytes | None]:
    """Every file below a folder; the lock, which holds nothing, is left out."""
    found = (path for path in folder.rglob("*") if path.name != "lock")
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in found}


@contextlib.contextmanager
def disk(folder: Path) -> Iterator[Path]:
    """A small disk of its own where we may mount one; elsewhere a folder."""
    disk = folder / "disk"
    disk.mkdir()
    mounted = os.geteuid() == 0
    if mounted:
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", disk]).returncode == 0
    try:
        yield disk
    finally:
        if mounted:
            subprocess.run(["umount", disk], check=True)
        shutil.rmtree(disk)


def fill(disk: Path, left: int) -> None:
    """Leaves so many bytes of a disk free."""
    space = os.statvfs(disk)
    with contextlib.suppress(OSError), (disk / "filler").open("wb") as file:
        file.write(bytes(max(0, space.f_bavail * space.f_frsize - left)))
