"""The policies by name: those that come with the package (policies.py), and those of the user's own modules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import flax.linen as nn

from loco_mjx.config import NetworkConfig
from loco_mjx.registry import Registry, caller


@dataclass(frozen=True)
class Policy:
    """An entry of POLICIES.

    Attributes:
        build: module from (NetworkConfig, size of the action).
        uses_state: whether it reads `state`.
        uses_depth: whether it reads `pixels/depth`.
        holds: whether the depth it is given is held for NetworkConfig.hold control steps.
        uses_privileged: whether it reads `privileged`, and so never leaves the simulator.
    """

    build: Callable[[NetworkConfig, int], nn.Module]
    uses_state: bool = True
    uses_depth: bool = True
    holds: bool = False
    uses_privileged: bool = False


Build = TypeVar("Build", bound=Callable[[NetworkConfig, int], nn.Module])
POLICIES: Registry[Policy] = Registry("policy")


@overload
def register_policy(
    name: str, *, uses_state: bool = True, uses_depth: bool = True, holds: bool = False, uses_privileged: bool = False
) -> Callable[[Build], Build]: ...


@overload
def register_policy(
    name: str,
    build: Build,
    *,
    uses_state: bool = True,
    uses_depth: bool = True,
    holds: bool = False,
    uses_privileged: bool = False,
) -> Build: ...


def register_policy(
    name: str,
    build: Any = None,
    *,
    uses_state: bool = True,
    uses_depth: bool = True,
    holds: bool = False,
    uses_privileged: bool = False,
) -> Any:
    """Adds a policy: as a decorator of its module's class, or called with what makes the module.

    ``@register_policy("mine", uses_depth=False)`` above ``class Mine(nn.Module)`` with the attributes ``config`` and
    ``actions``, whose ``__call__`` takes observations with any leading axes and returns `loco_mjx.networks.Outputs`;
    `loco_mjx.networks.heads` makes them from features. Parameters that only the value depends on have names that
    begin with ``value_``: optimisers and exports tell them by it.

    Args:
        name: of letters, digits, `.`, `_` and `-`.
        build: module from (NetworkConfig, size of the action).
        uses_state: see :class:`Policy`, as for the others.
        uses_depth: without it nothing is rendered.
        holds: whether depth is held for `network.hold` control steps.
        uses_privileged: whether it reads what only a simulator knows.

    Raises:
        UserError: if the name is taken or no name.
    """
    origin = caller()

    def register(build: Any) -> Any:
        POLICIES.register(name, Policy(build, uses_state, uses_depth, holds, uses_privileged), origin)
        return build

    return register if build is None else register(build)
