"""Checkpoints that survive a kill at any moment.

A checkpoint is ``checkpoints/<step>/`` with two Orbax trees, the curves and a manifest:

- ``state/``: all that training needs to go on: parameters, their mean, optimiser, normaliser, environments, keys, step
- ``policy/``: parameters (the mean, if there is one) and normaliser alone, for evaluation
- ``curves.csv``: the rows of metrics.csv so far
- ``manifest.json``: step, configuration, score, the size and CRC-32 of every file, and a CRC-32 of all of that

It is written under another name and renamed when it is whole, so a directory with a number for a name is complete. The
last two are kept, the best by evaluation, and one every so many samples where that is asked for: Orbax's policies
decide. One that was damaged or renamed later is found out by its manifest, and the one before it is used.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from loco_mjx.config import Config, flatten, from_dict, to_dict
from loco_mjx.errors import FULL, UserError, unwritable
from loco_mjx.run.checkpoint_files import (
    CHECKPOINTS,
    MANIFEST,
    PARTIAL,
    checksum,
    damage,
    files_of,
    fingerprint,
    path_of,
    remove,
    remove_leftovers,
    score_of,
    steps,
    sync,
    take_away,
)
from loco_mjx.run.directory import ABSENT, EXTENDABLE, NOTED, compared, open_new, read_json, write_json
from loco_mjx.run.orbax_trees import read_tree, write_trees
from loco_mjx.run.retention import kept

STATE, POLICY, CURVES = "state", "policy", "curves.csv"
BEST = "best"  # in place of a step: the checkpoint with the highest score

Policy = dict[str, Any]


def newest(directory: Path) -> int:
    """The samples trained at a run's newest checkpoint that is whole; 0 without one.

    Raises:
        UserError: as :func:`steps`.
    """
    return next((step for step in steps(directory) if damage(path_of(directory, step), STATE) is None), 0)


def choose(directory: Path, wanted: int | str) -> int:
    """The step of the checkpoint that somebody wants.

    Args:
        directory: of the run.
        wanted: the samples trained at it, or BEST.

    Raises:
        UserError: if the run has none such.
    """
    there = steps(directory)
    if wanted == BEST:
        scores = {step: score for step in there if (score := score_of(path_of(directory, step))) is not None}
        if not scores:
            raise UserError(f"no checkpoint of {directory} was evaluated; accepted: --step with a number of samples")
        return max(scores, key=lambda step: scores[step])
    if wanted not in there:
        accepted = ", ".join(map(str, sorted(there))) or "none, for it has no checkpoint yet"
        raise UserError(f"{directory} has no checkpoint at {wanted} samples; accepted: {accepted}")
    return int(wanted)


def save(
    directory: Path,
    step: int,
    state: Any,
    policy: Policy,
    config: Config,
    curves: str = "",
    score: float | None = None,
    keep_every: int | None = None,
) -> Path:
    """Writes a checkpoint, then removes those that need not be kept.

    Args:
        directory: the run's.
        step: samples trained so far.
        state: a pytree of arrays that this process holds whole, the full state of training.
        policy: a pytree of arrays, what evaluation needs.
        config: the run's configuration.
        curves: the rows of its metrics.csv.
        score: the return of an evaluation at this step; None without one.
        keep_every: samples between checkpoints that are kept for good; None: none is.

    Raises:
        UserError: if the disk is full or not writable.
    """
    final = path_of(directory, step)
    partial = final.with_name(PARTIAL + final.name)
    try:
        remove(partial)
        partial.parent.mkdir(exist_ok=True)  # but not the run's directory, which somebody may have removed on purpose
        partial.mkdir()
        write_trees(partial, {STATE: state, POLICY: policy})
        with open_new(partial / CURVES) as file:
            file.write(curves)
        files = {str(path.relative_to(partial)): fingerprint(path) for path in files_of(partial)}
        manifest = {"step": step, "config": to_dict(config), "score": score, "files": files}
        write_json(partial / MANIFEST, manifest | {"checksum": checksum(manifest)})
        remove(final)  # a damaged checkpoint of the same step, from which this run did not resume
        partial.rename(final)
        sync(final.parent)
    except (OSError, ValueError) as error:  # Orbax reports a full disk as a ValueError
        with contextlib.suppress(OSError):
            remove(partial)
        if isinstance(error, UserError):  # which says it
            raise
        raise unwritable(f"the checkpoint {final}", _system_error(error), "make room or access") from error
    for old in sorted(set(steps(directory)) - kept(directory, keep_every, config.ppo.samples_per_iteration)):
        take_away(path_of(directory, old))
    remove_leftovers(directory)
    return final


def _system_error(error: OSError | ValueError) -> OSError:
    """What the system said, which Orbax hides in a text."""
    if isinstance(error, OSError):
        return error
    known = (number for number in FULL if os.strerror(number) in str(error))
    return OSError(next(known, None), str(error).strip().splitlines()[0])


def whole_steps(directory: Path, say: Callable[[str], None], item: str = STATE) -> list[int]:
    """The steps of a run's undamaged checkpoints, newest first; `say` is called with a line about each other one."""
    problems = {step: damage(path_of(directory, step), item) for step in steps(directory)}
    for problem in filter(None, problems.values()):
        say(problem)
    return [step for step, problem in problems.items() if problem is None]


def drop_after(directory: Path, step: int) -> None:
    """Removes the checkpoints beyond a step, for a run that goes back to it together with others."""
    for newer in steps(directory):
        if newer > step:
            take_away(path_of(directory, newer))
    remove_leftovers(directory)


def restore(
    directory: Path,
    template: Any,
    config: Config,
    say: Callable[[str], None],
    item: str = STATE,
    at: int | None = None,
) -> tuple[Any, int] | None:
    """Reads the newest checkpoint that is whole.

    Args:
        directory: the run's.
        template: a pytree of ShapeDtypeStruct with shardings, or of arrays, like what was saved.
        config: the run's configuration.
        say: told about checkpoints that were passed over.
        item: STATE or POLICY.
        at: read the checkpoint of this step and no other.

    Returns:
        What was saved and the samples trained by then; None if there is no checkpoint.

    Raises:
        UserError: if a checkpoint is of another configuration, or all of them are damaged.
    """
    problems: list[str] = []
    for step in steps(directory) if at is None else [at]:
        checkpoint = path_of(directory, step)
        problem = damage(checkpoint, item)
        if problem is None:
            if problems:
                say(f"{'; '.join(problems)}; going on from the one before it, at {step:,} samples")
            check_config(checkpoint, config)
            return read_tree(checkpoint / item, template), step
        problems.append(problem)
    if not problems:
        return None
    if at is not None:
        raise UserError("; ".join(problems))
    folder = directory / CHECKPOINTS
    raise UserError(f"{'; '.join(problems)}; no whole checkpoint is left: delete {folder} to start again")


def curves(directory: Path, step: int) -> str | None:
    """The rows of a run's metrics.csv as they were at a checkpoint; None if it has none, or damaged ones."""
    checkpoint = path_of(directory, step)
    try:
        size_and_sum = tuple(read_json(checkpoint / MANIFEST)["files"][CURVES])
        path = checkpoint / CURVES
        return path.read_bytes().decode() if fingerprint(path) == size_and_sum else None
    except (UserError, KeyError, TypeError, OSError, UnicodeDecodeError):
        return None


def check_config(checkpoint: Path, config: Config) -> None:
    """Refuses a checkpoint of another configuration; only the total number of samples may differ.

    Raises:
        UserError: naming the first key that differs, with both values.
    """
    # A key that an older version did not have counts with its default.
    saved = flatten(to_dict(from_dict(Config, {}))) | flatten(read_json(checkpoint / MANIFEST)["config"])
    wanted = compared(config)
    for key in sorted((saved.keys() | wanted.keys()) - {NOTED, EXTENDABLE}):
        its, own = saved.get(key, ABSENT), wanted.get(key, ABSENT)
        if its != own:
            raise UserError(
                f"checkpoint {checkpoint} is of another configuration: its {key} is {its}, the run's {own}; remove it, "
                "or put back the run it belongs to"
            )
