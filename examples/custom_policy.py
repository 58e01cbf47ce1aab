"""A policy of one's own: what is seen gates what is felt.

loco-mjx train --import examples/custom_policy.py --task thin --policy gated
loco-mjx export runs/thin/gated/seed0 --import examples/custom_policy.py --out policy
"""

from collections.abc import Mapping

import flax.linen as nn
import jax

import loco_mjx
from loco_mjx.config import NetworkConfig
from loco_mjx.networks import Outputs, heads

WIDTH = 64


@loco_mjx.register_policy("gated")
class Gated(nn.Module):
    """A small network.

    Attributes:
        config: sizes; every key `network.*` of the configuration, to be used or not.
        actions: size of the action.
    """

    config: NetworkConfig
    actions: int

    @nn.compact
    def __call__(self, obs: Mapping[str, jax.Array]) -> Outputs:
        """`state` (..., n), normalised, and `pixels/depth` (..., 64, 64, frames), encoded, to Outputs."""
        depth = obs["pixels/depth"]
        x = depth.reshape(-1, *depth.shape[-3:])
        for i, (features, kernel) in enumerate(((16, 8), (32, 4))):
            x = nn.relu(nn.Conv(features, (kernel, kernel), (kernel, kernel), name=f"conv_{i}")(x))
        seen = x.reshape(*depth.shape[:-3], -1)  # whatever the leading axes (...) are
        felt = nn.tanh(nn.Dense(WIDTH, name="felt")(obs["state"]))
        features = felt * nn.sigmoid(nn.Dense(WIDTH, name="gate")(seen))
        return heads(self, (WIDTH,), features, lambda: features, obs)
