"""Whether a configuration, a policy's networks and what is observed fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from loco_mjx import config as config_lib
from loco_mjx.config import Config
from loco_mjx.errors import UserError
from loco_mjx.networks.outputs import DEPTH, PRIVILEGED
from loco_mjx.networks.policies import Networks


def check(config: Config, networks: Networks, observed: Mapping[str, Any], num_devices: int) -> None:
    """Refuses what does not fit together.

    Args:
        config: the run's configuration.
        networks: of its policy.
        observed: what the environment observes, by name.
        num_devices: to train on.

    Raises:
        UserError: if sizes do not divide over the devices, or the policy needs what is not observed.
    """
    config_lib.check(config, num_devices)
    if networks.uses_depth and DEPTH not in observed:
        raise UserError(f"policy '{config.policy}' needs depth; env.observation.depth.enabled is False")
    if networks.uses_privileged and PRIVILEGED not in observed:
        raise UserError(
            f"policy '{config.policy}' with critic '{config.network.critic}' needs the privileged observation; "
            "env.observation.privileged is False"
        )
    if config.ppo.unroll % networks.hold:
        raise UserError(
            f"network.hold {networks.hold} does not divide ppo.unroll {config.ppo.unroll}; accepted: a divisor of it"
        )
