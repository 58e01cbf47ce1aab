"""Pytrees of arrays as Orbax writes and reads them, each leaf under the name of its path, without Orbax's own words."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Any

import jax

from loco_mjx.errors import UserError


def _checkpointer() -> Any:
    """Orbax's. Each of several processes uses its own: the first one writes everything, all read everything."""
    import orbax.checkpoint as ocp

    if jax.process_count() == 1:
        return ocp.StandardCheckpointer()
    me = jax.process_index()
    alone = ocp.options.MultiprocessingOptions(me, active_processes={me}, barrier_sync_key_prefix=f"process{me}")
    return ocp.StandardCheckpointer(multiprocessing_options=alone)


def write_trees(folder: Path, trees: dict[str, Any]) -> None:
    """Writes pytrees into folders of their names.

    Raises:
        OSError: without write access.
        ValueError: as Orbax reports a full disk.
    """
    with _quiet(), _checkpointer() as checkpointer:
        for name, tree in trees.items():
            checkpointer.save((folder / name).absolute(), _by_name(tree))
            checkpointer.wait_until_finished()


def read_tree(folder: Path, template: Any) -> Any:
    """A pytree like a template of arrays or of shapes; what an older version did not write is the template's.

    Raises:
        UserError: if the folder holds another tree.
    """
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
