"""Flax networks: encoders, transformer, and the policies made of them."""

from loco_mjx.networks.policies import POLICIES, Networks, Outputs, heads, make_networks, register_policy

__all__ = ["POLICIES", "Networks", "Outputs", "heads", "make_networks", "register_policy"]
