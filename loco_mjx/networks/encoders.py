"""Encoders of the observation: an MLP over `state`, a small convolutional network over depth."""

from __future__ import annotations

from collections.abc import Sequence

import flax.linen as nn
import jax
import jax.numpy as jp

from loco_mjx.errors import UserError

TRUNK_INIT = nn.initializers.orthogonal(2.0**0.5)
PROJECTION_INIT = nn.initializers.orthogonal(1.0)
SMALLEST = 36  # pixels of which three convolutions leave one feature


class MLP(nn.Module):
    """Dense layers with a ReLU after each.

    Attributes:
        sizes: width of each layer.
    """

    sizes: Sequence[int]

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """(..., n) to (..., sizes[-1])."""
        for i, size in enumerate(self.sizes):
            x = nn.relu(nn.Dense(size, kernel_init=TRUNK_INIT, name=f"dense_{i}")(x))
        return x


class Head(nn.Module):
    """Hidden layers, then a linear output.

    Attributes:
        sizes: width of each hidden layer.
        outputs: width of the output.
        output_scale: gain of the last layer's orthogonal initialisation; small for an action's mean, so that
            the first policy is the initial Gaussian whatever it sees.
    """

    sizes: Sequence[int]
    outputs: int
    output_scale: float

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """(..., n) to (..., outputs)."""
        x = MLP(self.sizes, name="hidden")(x)
        return nn.Dense(self.outputs, kernel_init=nn.initializers.orthogonal(self.output_scale), name="output")(x)


def matmul_convolution(x: jax.Array, kernel: jax.Array, stride: int) -> jax.Array:
    """VALID convolution as matrix products, one per row of stride × stride blocks under the kernel.

    Args:
        x: (n, H, H, C) images.
        kernel: (k, k, C, features), k a multiple of the stride.
        stride: distance between outputs.

    Returns:
        (n, h, h, features).
    """
    size, _, channels, features = kernel.shape
    count, blocks = (x.shape[1] - size) // stride + 1, size // stride
    side = count + blocks - 1  # of the image, in blocks
    x = x[:, : side * stride, : side * stride].reshape(-1, side, stride, side, stride, channels)
    x = x.swapaxes(2, 3).reshape(-1, side, side, stride * stride * channels)  # space to depth
    x = jp.concatenate([x[:, :, j : j + count] for j in range(blocks)], axis=-1)  # what lies under a row of blocks
    rows = kernel.reshape(blocks, stride, blocks, stride, channels, features).swapaxes(1, 2)
    rows = rows.reshape(blocks, size * stride * channels, features)
    return sum(x[:, i : i + count] @ rows[i] for i in range(blocks))  # type: ignore[return-value]


class Convolution(nn.Module):
    """VALID convolution of square images, with `nn.Conv`'s parameters and result.

    On a CPU it multiplies matrices: inside a scan, XLA's CPU compiler turns the gradients of convolutions into
    loops that are some thirty times slower.

    Attributes:
        features: output channels.
        kernel: side of the kernel, a multiple of the stride.
        stride: distance between outputs.
        kernel_init: initialiser of the kernel.
    """

    features: int
    kernel: int
    stride: int
    kernel_init: nn.initializers.Initializer

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """(n, H, H, C) to (n, h, h, features)."""
        shape = (self.kernel, self.kernel, x.shape[-1], self.features)
        weights = self.param("kernel", self.kernel_init, shape)
        bias = self.param("bias", nn.initializers.zeros_init(), (self.features,))
        if jax.default_backend() == "cpu":
            return matmul_convolution(x, weights, self.stride) + bias
        dims = ("NHWC", "HWIO", "NHWC")
        return jax.lax.conv_general_dilated(x, weights, (self.stride,) * 2, "VALID", dimension_numbers=dims) + bias


class DepthEncoder(nn.Module):
    """Three convolutions over a stack of depth images (the trunk of Mnih et al. 2015).

    Attributes:
        features: channels of the three convolutions.
    """

    features: tuple[int, int, int] = (32, 64, 64)

    @nn.compact
    def __call__(self, depth: jax.Array) -> jax.Array:
        """(..., 64, 64, frames) encoded depth to (..., 4, 4, 64) features.

        Raises:
            UserError: if the images are not square, or too small.
        """
        height, width = depth.shape[-3:-1]
        if height != width or height < SMALLEST:
            raise UserError(
                f"env.observation.depth is {height} × {width} pixels, which this policy's convolutions cannot take; "
                f"accepted: square, {SMALLEST} or more"
            )
        x = depth.reshape(-1, *depth.shape[-3:])  # (n, 64, 64, frames)
        # (n, 64, 64, frames) -> (n, 15, 15, 32) -> (n, 6, 6, 64) -> (n, 4, 4, 64)
        for i, (features, kernel, stride) in enumerate(zip(self.features, (8, 4, 3), (4, 2, 1), strict=True)):
            x = nn.relu(Convolution(features, kernel, stride, TRUNK_INIT, name=f"conv_{i}")(x))
        return x.reshape(*depth.shape[:-3], *x.shape[1:])


class VisualTokens(nn.Module):
    """Turns the 4×4 feature map into N×N tokens with one more convolution.

    Attributes:
        token_dim: C, width of a token.
        tokens_per_side: N in {1, 2, 4}; the kernel and the stride are 4 / N.
    """

    token_dim: int
    tokens_per_side: int

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """(..., 4, 4, 64) to (..., N·N, C), row by row from the image's top left.

        Raises:
            UserError: if the map does not divide into N × N tokens.
        """
        side = features.shape[-3]
        size = side // self.tokens_per_side
        if size == 0 or side // size != self.tokens_per_side:
            raise UserError(
                f"env.observation.depth becomes {side} × {side} features, which do not make network.tokens_per_side "
                f"{self.tokens_per_side} squared; accepted: 64 × 64 pixels"
            )
        x = features.reshape(-1, *features.shape[-3:])
        x = Convolution(self.token_dim, size, size, PROJECTION_INIT, name="projection")(x)
        return x.reshape(*features.shape[:-3], self.tokens_per_side**2, self.token_dim)
