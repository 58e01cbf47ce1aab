"""A run's directory: its configuration, what it ran with, and the refusal to mix two runs.

- ``config.json``: the whole configuration
- ``info.json``: versions, devices, commit and command of the first start, and of each resumption
- ``metrics.csv``: the curves; tensorboard/ holds the same
- ``checkpoints/``: the last two states, the best by evaluation, and others (see loco_mjx/run/checkpoint.py)
- ``evaluation/``: what `loco-mjx evaluate` found
- ``teacher/``: the run of its teacher, for method `distill`
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from loco_mjx.config import Config, flatten, from_dict, to_dict
from loco_mjx.errors import UserError, unwritable

CONFIG, INFO, LOCK, PARTIAL = "config.json", "info.json", "lock", ".partial"
EXTENDABLE = "ppo.total_steps"
NOTED = "imports"  # modules may be named in several ways
ABSENT = 0.0  # the weight of a registered term of the reward that a configuration does not name
TEACHER = "teacher"  # the folder of a teacher's run, in that of the run that learns from it
_BEFORE_CONFIG = (LOCK, INFO, INFO + PARTIAL, CONFIG + PARTIAL, TEACHER)  # a teacher trains before its run


def write_json(path: Path, content: Any) -> None:
    """Writes a JSON file so that a kill at any moment leaves the old one or the new one.

    Raises:
        UserError: without write access.
    """
    partial = path.with_name(path.name + PARTIAL)
    with _writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_new(partial) as file:
            json.dump(content, file, indent=2)
            file.write("\n")
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)


def open_new(path: Path) -> TextIO:
    """Opens a new text file; what has its name, such as what a kill left, or a link, is taken away, not written to.

    Raises:
        OSError: without write access.
    """
    path.unlink(missing_ok=True)
    return path.open("x", newline="")


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Raises:
        UserError: if it cannot be read or is cut short.
    """
    try:
        return json.loads(path.read_text())
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}; a readable file is needed") from error
    except (ValueError, RecursionError) as error:  # the latter if it is nested thousands deep
        raise UserError(f"{path} is not valid JSON ({error}); restore it, or use another directory") from error


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise unwritable(path, error, "choose a writable directory") from error


def load_config(directory: Path) -> Config:
    """The configuration of the run in a directory.

    Raises:
        UserError: if there is no run, or one that this version cannot read.
    """
    if not (directory / CONFIG).is_file():
        raise UserError(f"no run in {directory} (it has no {CONFIG}); give a directory that `loco-mjx train` wrote")
    values = read_json(directory / CONFIG)
    if not isinstance(values, dict):
        raise UserError(f"{directory / CONFIG} holds no configuration; restore it, or use another directory")
    try:
        return from_dict(Config, values)
    except (UserError, TypeError, AttributeError) as error:
        raise UserError(f"{directory / CONFIG} is of another version: {error}") from error


def find(directory: Path) -> Config | None:
    """The configuration of the run in a directory; None where a new run may start.

    Raises:
        UserError: if the directory holds something else, or is none.
    """
    if not directory.exists():
        return None
    if not directory.is_dir():
        raise UserError(f"{directory} is a file; choose a directory for the run")
    if (directory / CONFIG).exists():
        return load_config(directory)
    # A run killed before its configuration was written leaves only these.
    foreign = sorted(entry.name for entry in directory.iterdir() if entry.name not in _BEFORE_CONFIG)
    if foreign:
        raise UserError(f"{directory} holds '{foreign[0]}' and no run; choose an empty or new directory")
    return None


def reconcile(directory: Path, found: Config, wanted: Config) -> None:
    """Checks that a directory's run is the one that is wanted; only the total number of samples may differ.

    Raises:
        UserError: naming the first key that differs, with both values.
    """
    flat_found, flat_wanted = compared(found), compared(wanted)
    taught = found.method == "distill"
    by_ppo = not taught or found.distill.imitation < 1.0
    rates = by_ppo and found.ppo.learning_rate_decay, taught and found.distill.learning_rate_decay
    changing = {
        "learning rate decays": any(rates),
        "exploration narrows": found.ppo.final_std is not None,
        "imitation ends": taught and by_ppo,
    }
    changes = " and ".join(name for name, does in changing.items() if does)
    for key in {**flat_found, **flat_wanted}:
        value, asked = (flat.get(key, ABSENT) for flat in (flat_found, flat_wanted))
        if value == asked or (key == EXTENDABLE and not changes):
            continue
        why = f" (its {changes} over them)" if key == EXTENDABLE else ""
        raise UserError(
            f"{directory} holds another run: its {key} is {json.dumps(value)}{why}, asked for "
            f"{json.dumps(asked)}; use the same options to resume it, or another --out"
        )


def compared(config: Config) -> dict[str, Any]:
    """A configuration on one level, without what it only notes; a term of the reward may be ABSENT."""
    return {key: value for key, value in flatten(to_dict(config)).items() if key != NOTED}


@contextmanager
def claim(directory: Path) -> Iterator[None]:
    """Makes the directory and locks it for this process; the lock ends with the process, however that ends.

    Raises:
        UserError: without write access, or if another process is training in it.
    """
    lock = directory / LOCK
    with _writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    if lock.is_symlink():
        raise UserError(f"{lock} is a symbolic link, which a run's lock never is; remove it")
    with _writing(lock):
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    with open(descriptor, "rb", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(f"another process is training in {directory}; choose another --out, or stop it") from None
        yield


def record_start(directory: Path, config: Config, provenance: dict[str, Any]) -> None:
    """Writes the configuration and what the run runs with, before its first step; notes each resumption.

    Args:
        directory: the run's.
        config: the whole configuration.
        provenance: versions, devices, commit and command (see loco_mjx/run/provenance.py), with the step begun at.
    """
    info = read_json(directory / INFO) if (directory / INFO).exists() else None
    if info is None:
        info = provenance | {"resumed": []}
    else:
        info |= {"resumed": [*info.get("resumed", []), provenance]}
    write_json(directory / INFO, info)
    write_json(directory / CONFIG, to_dict(config))
