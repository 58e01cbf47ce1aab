"""Flax networks: encoders, transformer, and the policies made of them."""

from loco_mjx.networks.policies import POLICIES, Networks, Outputs, make_networks

__all__ = ["POLICIES", "Networks", "Outputs", "make_networks"]
