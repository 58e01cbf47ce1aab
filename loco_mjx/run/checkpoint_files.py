"""What a checkpoint is on the disk: its name, its manifest, and whether its files are still what was written."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from loco_mjx.config import flatten
from loco_mjx.errors import UserError
from loco_mjx.run.directory import read_json

CHECKPOINTS, MANIFEST = "checkpoints", "manifest.json"
PARTIAL, OLD = ".partial-", ".old-"  # before the names of those that are being written, and taken away
_NAME = r"[1-9]\d{12,}|\d{12}"  # as path_of makes them
_BLOCK = 1 << 22  # bytes read at once


def steps(directory: Path) -> list[int]:
    """The samples trained at each checkpoint of a run, newest first, as their names have it.

    Raises:
        UserError: if there is a folder of checkpoints that cannot be read.
    """
    folder = directory / CHECKPOINTS
    try:
        names = os.listdir(folder) if os.path.lexists(folder) else []
    except OSError as error:
        raise UserError(f"cannot read {folder}: {error.strerror or error}; restore or remove it") from error
    return sorted((int(name) for name in names if re.fullmatch(_NAME, name, re.ASCII)), reverse=True)


def path_of(directory: Path, step: int) -> Path:
    """Where the checkpoint of a step lies."""
    return directory / CHECKPOINTS / f"{step:012d}"


def score_of(checkpoint: Path) -> float | None:
    """The return of the evaluation at a checkpoint; None if there was none, or its manifest cannot be read."""
    try:
        score = read_json(checkpoint / MANIFEST).get("score")
        return None if score is None else float(score)
    except (UserError, AttributeError, TypeError, ValueError):
        return None


def damage(checkpoint: Path, item: str) -> str | None:
    """What is wrong with the files of a checkpoint, or None."""
    try:
        manifest = read_json(checkpoint / MANIFEST)
        flatten(manifest["config"])
        expected = {name: tuple(size_and_sum) for name, size_and_sum in manifest["files"].items()}
        step, written = manifest["step"], manifest.pop("checksum", None)
        renamed = path_of(checkpoint.parent.parent, step).name != checkpoint.name
    except (UserError, KeyError, TypeError, AttributeError, ValueError):
        return f"checkpoint {checkpoint} is cut short (its {MANIFEST} is missing or damaged)"
    if written not in (None, checksum(manifest)):  # None: an older version's
        return f"checkpoint {checkpoint} is damaged ({MANIFEST} has changed)"
    if renamed:
        return f"checkpoint {checkpoint} is one of {step:,} samples under another name"
    for name, size_and_sum in expected.items():
        if not name.startswith(item + "/"):
            continue
        path = checkpoint / name
        if not path.is_file():
            return f"checkpoint {checkpoint} is cut short ({name} is missing)"
        if path.stat().st_size != size_and_sum[0]:
            return f"checkpoint {checkpoint} is cut short ({name} has {path.stat().st_size} of {size_and_sum[0]} bytes)"
        if fingerprint(path) != size_and_sum:
            return f"checkpoint {checkpoint} is damaged ({name} has changed)"
    return None


def checksum(manifest: dict[str, Any]) -> int:
    """CRC-32 of a manifest without its own checksum."""
    return zlib.crc32(json.dumps(manifest, sort_keys=True).encode())


def remove_leftovers(directory: Path) -> None:
    """Removes what kills have left behind, and checkpoints whose names were taken away."""
    for prefix in (PARTIAL, OLD):
        for leftover in (directory / CHECKPOINTS).glob(prefix + "*"):
            with contextlib.suppress(OSError):
                remove(leftover)


def remove(path: Path) -> None:
    """Removes a folder with its content; of a link itself, not what it leads to."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)


def take_away(checkpoint: Path) -> None:
    """Takes away a checkpoint's name, at once; `remove_leftovers` removes its files."""
    checkpoint.rename(checkpoint.with_name(OLD + checkpoint.name))


def files_of(folder: Path) -> Iterator[Path]:
    """All files below a folder, in order."""
    return (path for path in sorted(folder.rglob("*")) if path.is_file())


def fingerprint(path: Path) -> tuple[int, int]:
    """Size and CRC-32 of a file, which is on the disk by then."""
    size, crc = 0, 0
    with path.open("rb") as file:
        os.fsync(file.fileno())
        while block := file.read(_BLOCK):
            size += len(block)
            crc = zlib.crc32(block, crc)
    return size, crc


def sync(folder: Path) -> None:
    """Waits until a folder's entries are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
