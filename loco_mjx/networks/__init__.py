"""Flax networks: encoders, transformer, and the policies made of them."""

from loco_mjx.networks.outputs import Outputs, heads
from loco_mjx.networks.policies import Networks, make_networks
from loco_mjx.networks.registry import POLICIES, register_policy

__all__ = ["POLICIES", "Networks", "Outputs", "heads", "make_networks", "register_policy"]
