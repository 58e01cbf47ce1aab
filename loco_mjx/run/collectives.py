"""What the processes of one run tell each other; with one process, which is the rule, everything here does nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from loco_mjx.errors import UserError

_TEXT = 1 << 15  # bytes of the longest text that processes share


def is_first() -> bool:
    """Whether this process is the one that writes and speaks."""
    return jax.process_index() == 0


def fetch_whole(tree: Any) -> Any:
    """A pytree of arrays, with those that are sharded over processes gathered."""
    if jax.process_count() == 1:
        return tree
    from jax.experimental import multihost_utils

    return multihost_utils.process_allgather(tree, tiled=True)


def allgather(value: Any) -> np.ndarray:
    """(processes, ...) every process's value."""
    if jax.process_count() == 1:
        return np.asarray(value)[None]
    from jax.experimental import multihost_utils

    return np.asarray(multihost_utils.process_allgather(np.asarray(value)))


def broadcast(text: str) -> str:
    """The first process's text."""
    if jax.process_count() == 1:
        return text
    data = np.frombuffer(text.encode()[:_TEXT].ljust(_TEXT, b"\0"), np.uint8)
    return bytes(allgather(data)[0]).rstrip(b"\0").decode(errors="replace")


def agreed(save: bool, stop: int | None, failed: bool = False) -> tuple[bool, int | None, bool]:
    """Whether the first process finds that it is time to save, any process's signal, whether any has failed."""
    if jax.process_count() == 1:
        return save, stop, failed
    told = allgather(np.array([save, stop or 0, failed], np.int32))
    return bool(told[0, 0]), int(told[:, 1].max()) or None, bool(told[:, 2].any())


def on_first(action: Callable[[], None]) -> None:
    """Lets the first process do something when all have come here; what it refuses, all refuse.

    Raises:
        UserError: as the action did.
    """
    allgather(0)
    problem: UserError | None = None
    if is_first():
        try:
            action()
        except UserError as error:
            problem = error
    text = broadcast("" if problem is None else str(problem))
    if text:
        raise problem or UserError(text)


def check_same(text: str, what: str) -> None:
    """Checks that all processes have the same text.

    Raises:
        UserError: naming those that differ from the first.
    """
    same = allgather(np.int32(broadcast(text) == text))
    others = ", ".join(str(i) for i in np.flatnonzero(same == 0))
    if others:
        raise UserError(f"process {others} has another {what} than process 0; start all with the same options")
