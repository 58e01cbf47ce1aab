"""The terms of the reward by name: functions of what happened in a control step, and their default weights."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from loco_mjx.registry import Registry


@dataclass(frozen=True)
class Term:
    """A term of the reward.

    Attributes:
        function: from :class:`loco_mjx.env.reward.RewardInputs` to the term's value, ().
        weight: that it has unless the configuration says otherwise; None: RewardConfig has a key of its name.
    """

    function: Callable[[Any], Any]
    weight: float | None = None


class Weights(dict[str, float]):
    """Weights by the terms' names, not to be changed: as the configuration that holds it, it has a hash."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))


REWARDS: Registry[Term] = Registry("reward term", re.compile(r"[a-z][a-z0-9_]*"), "small letters, digits and '_'")


def default_weights() -> Weights:
    """Of the terms that users have registered."""
    return Weights({name: term.weight for name, term in REWARDS.items() if term.weight is not None})
