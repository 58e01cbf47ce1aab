"""Checkpoints that survive a kill at any moment.

A checkpoint is ``checkpoints/<step>/`` with two Orbax trees, the curves and a manifest:

- ``state/``: everything training needs to go on: parameters, optimiser, normaliser, environments, keys, step
- ``policy/``: parameters and normaliser alone, for evaluation
- ``curves.csv``: the rows of metrics.csv so far
- ``manifest.json``: step, configuration, score, the size and CRC-32 of every file, and a CRC-32 of all of that

It is written under another name and renamed when it is whole, so a directory with a number for a name is complete. The
last two are kept, the best by evaluation, and one every so many samples where that is asked for: Orbax's policies
decide. One that was damaged or renamed later is found out by its manifest, and the one before it is used.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import logging
import os
import re
import shutil
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import jax

from loco_mjx.config import Config, flatten, from_dict, to_dict
from loco_mjx.errors import FULL, UserError, unwritable
from loco_mjx.run.directory import ABSENT, EXTENDABLE, NOTED, compared, open_new, read_json, write_json

CHECKPOINTS, STATE, POLICY, CURVES, MANIFEST = "checkpoints", "state", "policy", "curves.csv", "manifest.json"
LATEST = 2  # how many of the newest are kept
BEST = "best"  # in place of a step: the checkpoint with the highest score
_NAME = r"[1-9]\d{12,}|\d{12}"  # as path_of makes them
_PARTIAL, _OLD = ".partial-", ".old-"
_BLOCK = 1 << 22  # bytes read at once

Policy = dict[str, Any]


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


def score_of(checkpoint: Path) -> float | None:
    """The return of the evaluation at a checkpoint; None if there was none, or its manifest cannot be read."""
    try:
        score = read_json(checkpoint / MANIFEST).get("score")
        return None if score is None else float(score)
    except (UserError, AttributeError, TypeError, ValueError):
        return None


def path_of(directory: Path, step: int) -> Path:
    """Where the checkpoint of a step lies."""
    return directory / CHECKPOINTS / f"{step:012d}"


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
    partial = final.with_name(_PARTIAL + final.name)
    try:
        _remove(partial)
        partial.parent.mkdir(exist_ok=True)  # but not the run's directory: whoever removes that wants it gone
        partial.mkdir()
        _write_trees(partial, {STATE: state, POLICY: policy})
        with open_new(partial / CURVES) as file:
            file.write(curves)
        files = {str(path.relative_to(partial)): _fingerprint(path) for path in _files(partial)}
        manifest = {"step": step, "config": to_dict(config), "score": score, "files": files}
        write_json(partial / MANIFEST, manifest | {"checksum": _checksum(manifest)})
        _remove(final)  # a damaged checkpoint of the same step, from which this run did not resume
        partial.rename(final)
        _sync(final.parent)
    except (OSError, ValueError) as error:  # Orbax reports a full disk as a ValueError
        with contextlib.suppress(OSError):
            _remove(partial)
        raise unwritable(f"the checkpoint {final}", _system_error(error), "make room or access") from error
    for old in sorted(set(steps(directory)) - kept(directory, keep_every, config.ppo.samples_per_iteration)):
        _take_away(path_of(directory, old))
    _remove_leftovers(directory)
    return final


def _system_error(error: OSError | ValueError) -> OSError:
    """What the system said, which Orbax hides in a text."""
    if isinstance(error, OSError):
        return error
    known = (number for number in FULL if os.strerror(number) in str(error))
    return OSError(next(known, None), str(error).strip().splitlines()[0])


def whole_steps(directory: Path, say: Callable[[str], None], item: str = STATE) -> list[int]:
    """The steps of a run's checkpoints that are not damaged, newest first; `say` is told about the others."""
    problems = {step: damage(path_of(directory, step), item) for step in steps(directory)}
    for problem in filter(None, problems.values()):
        say(problem)
    return [step for step, problem in problems.items() if problem is None]


def drop_after(directory: Path, step: int) -> None:
    """Removes the checkpoints beyond a step, for a run that goes back to it together with others."""
    for newer in steps(directory):
        if newer > step:
            _take_away(path_of(directory, newer))
    _remove_leftovers(directory)


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
            return _read_tree(checkpoint / item, template), step
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
        return path.read_bytes().decode() if _fingerprint(path) == size_and_sum else None
    except (UserError, KeyError, TypeError, OSError, UnicodeDecodeError):
        return None


def damage(checkpoint: Path, item: str) -> str | None:
    """What is wrong with the files of a checkpoint, or None."""
    try:
        manifest = read_json(checkpoint / MANIFEST)
        flatten(manifest["config"])
        expected = {name: tuple(size_and_sum) for name, size_and_sum in manifest["files"].items()}
        step, checksum = manifest["step"], manifest.pop("checksum", None)
        renamed = path_of(checkpoint.parent.parent, step).name != checkpoint.name
    except (UserError, KeyError, TypeError, AttributeError, ValueError):
        return f"checkpoint {checkpoint} is cut short (its {MANIFEST} is missing or damaged)"
    if checksum not in (None, _checksum(manifest)):  # None: an older version's
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
        if _fingerprint(path) != size_and_sum:
            return f"checkpoint {checkpoint} is damaged ({name} has changed)"
    return None


def _checksum(manifest: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(manifest, sort_keys=True).encode())


def check_config(checkpoint: Path, config: Config) -> None:
    """Refuses a checkpoint of another configuration; only the total number of samples may differ.

    Raises:
        UserError: naming the first key that differs, with both values.
    """
    # A key that an older version did not have was at what is now its default.
    saved = flatten(to_dict(from_dict(Config, {}))) | flatten(read_json(checkpoint / MANIFEST)["config"])
    wanted = compared(config)
    for key in sorted((saved.keys() | wanted.keys()) - {NOTED, EXTENDABLE}):
        its, own = saved.get(key, ABSENT), wanted.get(key, ABSENT)
        if its != own:
            raise UserError(
                f"checkpoint {checkpoint} is of another configuration: its {key} is {its}, the run's {own}; remove it, "
                "or put back the run it belongs to"
            )


def _checkpointer() -> Any:
    """Orbax's; of several processes each works by itself: the first one writes everything, and all read everything."""
    import orbax.checkpoint as ocp

    if jax.process_count() == 1:
        return ocp.StandardCheckpointer()
    me = jax.process_index()
    alone = ocp.options.MultiprocessingOptions(me, active_processes={me}, barrier_sync_key_prefix=f"process{me}")
    return ocp.StandardCheckpointer(multiprocessing_options=alone)


def _write_trees(folder: Path, trees: dict[str, Any]) -> None:
    with _quiet(), _checkpointer() as checkpointer:
        for name, tree in trees.items():
            checkpointer.save((folder / name).absolute(), _by_name(tree))
            checkpointer.wait_until_finished()


def _read_tree(folder: Path, template: Any) -> Any:
    import orbax.checkpoint as ocp

    leaves, structure = jax.tree.flatten(template)
    names = list(_by_name(template, empty=True))
    target = jax.tree.map(ocp.utils.to_shape_dtype_struct, _by_name(template))
    try:
        with _quiet(), _checkpointer() as checkpointer:
            found = checkpointer.restore(folder.absolute(), target)
        return jax.tree.unflatten(structure, [found.get(name, leaf) for name, leaf in zip(names, leaves, strict=True)])
    except (ValueError, KeyError, TypeError) as error:
        first = str(error).strip().splitlines()[0]
        raise UserError(f"checkpoint {folder.parent} was written by another version of loco-mjx: {first}") from error


def _by_name(tree: Any, empty: bool = False) -> dict[str, Any]:
    """The leaves of a pytree by their path, such as `params.params.state_token.kernel`.

    Args:
        tree: of arrays, or shapes.
        empty: take in arrays without elements, which Orbax refuses and which hold nothing to save.
    """
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    named = {_name(path): leaf for path, leaf in leaves if empty or leaf.size}
    return named


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".").replace("/", ":")


@dataclass(frozen=True)
class _Info:
    """What Orbax's policies read of a checkpoint."""

    step: int
    metrics: dict[str, Any] | None
    time: datetime.datetime


def kept(directory: Path, every: int | None, per_iteration: int) -> set[int]:
    """The steps of the checkpoints that are kept: the last two, the best, and the first ones after every so often.

    Args:
        directory: of the run.
        every: samples between those that are kept for good; None: none is.
        per_iteration: samples of an iteration.
    """
    from orbax.checkpoint import checkpoint_managers as managers

    there = sorted(steps(directory))
    scores = {step: score_of(path_of(directory, step)) for step in there}
    infos = [
        _Info(step, None if score is None else {"score": score}, datetime.datetime.fromtimestamp(0, datetime.UTC))
        for step, score in scores.items()
    ]
    policies = [
        managers.LatestN(LATEST),
        managers.BestN(n=1, get_metric_fn=itemgetter("score"), keep_checkpoints_without_metrics=False),
        managers.CustomSteps([step for step in there if passes(step, every, per_iteration)]),
    ]
    keep = managers.AnyPreservationPolicy(policies).should_preserve(infos, context=managers.PreservationContext())
    return {step for step, stays in zip(there, keep, strict=True) if stays}


def passes(step: int, every: int | None, per_iteration: int) -> bool:
    """Whether the iteration that ended at a step went past a multiple of `every` samples."""
    return every is not None and step > 0 and step % every < per_iteration


def _remove_leftovers(directory: Path) -> None:
    """Removes what kills have left behind, and checkpoints whose names were taken away."""
    for prefix in (_PARTIAL, _OLD):
        for leftover in (directory / CHECKPOINTS).glob(prefix + "*"):
            with contextlib.suppress(OSError):
                _remove(leftover)


def _remove(path: Path) -> None:
    """Removes a folder with its content; of a link itself, not what it leads to."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)


def _take_away(checkpoint: Path) -> None:
    checkpoint.rename(checkpoint.with_name(_OLD + checkpoint.name))


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_file())


def _fingerprint(path: Path) -> tuple[int, int]:
    """Size and CRC-32 of a file, which is on the disk by then."""
    size, checksum = 0, 0
    with path.open("rb") as file:
        os.fsync(file.fileno())
        while block := file.read(_BLOCK):
            size += len(block)
            checksum = zlib.crc32(block, checksum)
    return size, checksum


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class _quiet:  # noqa: N801
    """Keeps Orbax's log lines and its threads' tracebacks out of the terminal; errors still reach the caller.

    After an error its other writes go on for a while: each fails to tell an event loop that is closed, or says that
    nobody asked how it ended. So after one they stay quiet.
    """

    def __enter__(self) -> None:
        self._levels = {logger: logger.level for logger in map(logging.getLogger, ("absl", "asyncio"))}
        self._hook = sys.unraisablehook
        for logger in self._levels:
            logger.setLevel(logging.CRITICAL)
        sys.unraisablehook = self._filter

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            return
        for logger, level in self._levels.items():
            logger.setLevel(level)
        sys.unraisablehook = self._hook

    def _filter(self, unraisable: Any) -> None:
        if str(unraisable.exc_value) != "Event loop is closed":
            self._hook(unraisable)
