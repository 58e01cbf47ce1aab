"""A policy with some keys of the configuration changed: what an ablation compares, written `POLICY+KEY=VALUE`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

from loco_mjx import controllers
from loco_mjx.config import Config, flatten, to_dict, with_controller
from loco_mjx.errors import UnknownNameError, UserError

CONTROLLER = "env.controller"
# Keys that make another method of the same policy; the other keys are how it was trained.
METHOD_KEYS = (
    "method",
    "network.tokens_per_side",
    "network.layers",
    "network.token_dim",
    "network.latent_dim",
    "network.hold",
    CONTROLLER,
    "env.action.diagonal",
    "env.observation.state_frames",
    "env.observation.displacement",
    "env.observation.depth.frames",
    "env.observation.depth.noise",
)
# Keys that have an option of their own.
GIVEN = {"env.task": "--tasks", "ppo.total_steps": "--total-steps"}
_NETWORK = "network."
SHORT = {"method": "method", "controller": CONTROLLER}  # keys that need no dot beside the network's


@cache
def default_keys(controller: str = controllers.DEFAULT) -> Mapping[str, Any]:
    """Every key of the configuration, on one level, with its default under a controller."""
    return MappingProxyType(flatten(to_dict(with_controller(Config(), controller))))


def as_options(changes: Iterable[tuple[str, str]]) -> list[str]:
    """Names and values as options of `loco-mjx train`: `--ppo.clip 0.1`; several values are joined by commas."""
    return [word for name, value in changes for word in (f"--{name.replace('_', '-')}", *value.split(","))]


@dataclass(frozen=True)
class Variant:
    """A policy and the keys in which it differs from its preset.

    Attributes:
        policy: its name.
        changes: pairs of a configuration's key and the value, both as words.
    """

    policy: str
    changes: tuple[tuple[str, str], ...] = ()

    @property
    def label(self) -> str:
        """What it is called, on the command line and as a directory: `loco-transformer+layers=1`."""
        return "+".join([self.policy, *(f"{_short(key)}={value}" for key, value in self.changes)])

    @property
    def words(self) -> list[str]:
        """Options of `loco-mjx train`."""
        return ["--policy", self.policy, *as_options(self.changes)]

    def matches(self, config: Mapping[str, Any]) -> bool:
        """Whether a run's flat configuration is of this variant, however it was trained."""
        changes = dict(self.changes)
        defaults = default_keys(changes.get(CONTROLLER, controllers.DEFAULT))
        wanted = {key: changes.get(key, str(defaults[key])) for key in {*METHOD_KEYS, *changes}}
        same = all(str(config.get(key)) == value for key, value in wanted.items())
        return config.get("policy") == self.policy and same


def _short(key: str) -> str:
    """A key as a label has it."""
    return next((short for short, whole in SHORT.items() if whole == key), key.removeprefix(_NETWORK))


def parse_variant(text: str) -> Variant:
    """Reads `POLICY` or `POLICY+KEY=VALUE+...`; a key without a dot is one of the network's.

    Raises:
        UserError: if the policy or a key is unknown, or there is no value.
    """
    from loco_mjx.networks.registry import POLICIES

    policy, *changes = text.split("+")
    if policy not in POLICIES:
        raise UnknownNameError("policy", policy, POLICIES)
    return Variant(policy, tuple(parse_change(change) for change in changes))


def parse_change(text: str) -> tuple[str, str]:
    """Reads `KEY=VALUE`.

    Raises:
        UserError: if the key is unknown, or there is no value.
    """
    key, _, value = (part.strip() for part in text.partition("="))
    if not key or not value:
        raise UserError(f"'{text}' changes nothing; accepted: KEY=VALUE, e.g. layers=1 or ppo.clip=0.1")
    key = key.replace("-", "_")
    key = key if "." in key else SHORT.get(key, _NETWORK + key)
    known = default_keys()
    if key in GIVEN:
        raise UserError(f"'{key}' is given by {GIVEN[key]}; change another key")
    if key not in known:
        raise UnknownNameError("key", key, [name for name in known if "." in name])
    return key, value
