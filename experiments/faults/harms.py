"""What is done to the files of a run."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

STEP, STEPS = 32, 32  # samples between checkpoints, and how many a run may have


def _flip(path: Path, numbers: random.Random) -> None:
    content = bytearray(path.read_bytes() or b"\0")
    content[numbers.randrange(len(content))] ^= 1 << numbers.randrange(8)
    path.write_bytes(content)


def _cut(path: Path, numbers: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: numbers.randrange(len(content) or 1)])


def _overwrite(path: Path, numbers: random.Random) -> None:
    path.write_bytes(numbers.randbytes(max(1, path.stat().st_size)))


def _extend(path: Path, numbers: random.Random) -> None:
    path.write_bytes(path.read_bytes() + numbers.randbytes(numbers.randint(1, 100)))


def _become_folder(path: Path, numbers: random.Random) -> None:
    path.unlink()
    path.mkdir()


def _link_to_itself(path: Path, numbers: random.Random) -> None:
    path.unlink()
    path.symlink_to(path)


def _rename_parent(path: Path, numbers: random.Random) -> None:
    """Gives a checkpoint another step's name; other files get another one themselves."""
    if path.parent.name.isdigit():
        path.parent.rename(path.parent.with_name(f"{STEP * numbers.randint(1, STEPS):012d}.tmp"))
        (moved,) = path.parent.parent.glob("*.tmp")
        target = moved.with_suffix("")
        shutil.rmtree(target, ignore_errors=True)
        moved.rename(target)
    else:
        path.rename(path.with_name(path.name + ".moved"))


HARMS: dict[str, Callable[[Path, random.Random], None]] = {
    "a flipped bit": _flip,
    "a cut": _cut,
    "random bytes instead": _overwrite,
    "random bytes more": _extend,
    "removal": lambda path, numbers: path.unlink(),
    "emptying": lambda path, numbers: path.write_bytes(b""),
    "a folder instead": _become_folder,
    "a link to itself instead": _link_to_itself,
    "another name": _rename_parent,
}
