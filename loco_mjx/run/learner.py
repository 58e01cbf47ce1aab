"""What the training loop asks of a learner, of one run or of several that train side by side."""

from __future__ import annotations

from typing import Any, Protocol

import jax


class Learner(Protocol):
    """What the loop needs of :class:`loco_mjx.ppo.trainer.Trainer`."""

    def init(self) -> Any:
        """The state before the first iteration."""

    def make_pool(self, iteration: int) -> Any:
        """The scenes of an iteration."""

    def iterate(self, state: Any, pool: Any) -> tuple[Any, dict[str, jax.Array]]:
        """One iteration: the next state and scalars."""


class GroupLearner(Learner, Protocol):
    """What it needs of :class:`loco_mjx.ppo.multi_seed.SeedsTrainer`: several runs, each metric of shape (runs,)."""

    def split(self, state: Any) -> list[Any]:
        """Each run's own state."""

    def join(self, parts: list[Any]) -> Any:
        """The inverse of `split`."""


class Single:
    """One run's learner as that of a group."""

    def __init__(self, learner: Learner) -> None:
        self.init, self.make_pool, self.iterate = learner.init, learner.make_pool, learner.iterate

    def split(self, state: Any) -> list[Any]:
        """The one run's state."""
        return [state]

    def join(self, parts: list[Any]) -> Any:
        """The inverse of `split`."""
        return parts[0]
