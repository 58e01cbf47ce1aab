"""A policy's networks as an ONNX graph, written from the parameters: observation in, what its controller takes out.

Sizes are fixed and there is no batch axis: a robot has one observation. Weights keep the order of their axes wherever
ONNX's operators allow; images go through convolutions as (1, channels, height, width).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loco_mjx.config import Config
from loco_mjx.controllers import Controller
from loco_mjx.deploy.description import DEPTH, STATE
from loco_mjx.env.action import DIAGONAL

OPSET, IR_VERSION = 17, 8  # LayerNormalization came with 17; onnxruntime 1.14 and TensorRT 8.6 read both
LAYER_NORM_EPSILON = 1e-5
Tree = Mapping[str, Any]


@dataclass
class Builder:
    """Collects nodes and weights; every method adds an operator and returns its output's name."""

    nodes: list[Any] = field(default_factory=list)
    weights: list[Any] = field(default_factory=list)

    def constant(self, value: Any, kind: type = np.float32) -> str:
        """A weight."""
        from onnx import numpy_helper

        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.array(value, kind, order="C"), name))
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Any operator with one output."""
        from onnx import helper

        name = f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def dense(self, x: str, layer: Tree) -> str:
        """Product with the kernel, plus the bias, over the last axis."""
        product = self.op("MatMul", x, self.constant(layer["kernel"]))
        return self.op("Add", product, self.constant(layer["bias"]))

    def mlp(self, x: str, layers: Tree) -> str:
        """Dense layers `dense_0`, `dense_1`, … with a ReLU after each."""
        for i in range(len(layers)):
            x = self.op("Relu", self.dense(x, layers[f"dense_{i}"]))
        return x

    def head(self, x: str, head: Tree) -> str:
        """Hidden layers and a linear output."""
        return self.dense(self.mlp(x, head.get("hidden", {})), head["output"])

    def convolution(self, x: str, layer: Tree, stride: int) -> str:
        """VALID convolution of (1, C, H, W); the kernel comes as (k, k, C, features)."""
        kernel = self.constant(np.transpose(layer["kernel"], (3, 2, 0, 1)))
        return self.op("Conv", x, kernel, self.constant(layer["bias"]), strides=[stride, stride])

    def layer_norm(self, x: str, layer: Tree) -> str:
        """Normalisation over the last axis."""
        scale, bias = self.constant(layer["scale"]), self.constant(layer["bias"])
        return self.op("LayerNormalization", x, scale, bias, axis=-1, epsilon=LAYER_NORM_EPSILON)

    def reshape(self, x: str, *shape: int) -> str:
        """Another shape."""
        return self.op("Reshape", x, self.constant(shape, np.int64))


def _depth_encoder(b: Builder, encoder: Tree) -> str:
    """(height, width, frames) depth to (1, 64, 4, 4) features."""
    rounded = b.op("Cast", b.op("Cast", DEPTH, to=10), to=1)  # through float16 and back, as in training
    x = b.op("Unsqueeze", b.op("Transpose", rounded, perm=[2, 0, 1]), b.constant([0], np.int64))
    for i, stride in enumerate((4, 2, 1)):
        x = b.op("Relu", b.convolution(x, encoder[f"conv_{i}"], stride))
    return x


def _visual_tokens(b: Builder, features: str, tokens: Tree, per_side: int) -> str:
    """(1, 64, 4, 4) features to (N·N, C) tokens."""
    x = b.convolution(features, tokens["projection"], 4 // per_side)
    channels = tokens["projection"]["kernel"].shape[-1]
    return b.reshape(b.op("Transpose", x, perm=[0, 2, 3, 1]), per_side**2, channels)


def _flat_visual(b: Builder, params: Tree) -> str:
    """(width,) the visual features, flattened as (4, 4, 64) and projected."""
    features = b.op("Transpose", _depth_encoder(b, params["depth_encoder"]), perm=[0, 2, 3, 1])
    return b.op("Relu", b.dense(b.reshape(features, -1), params["visual_projection"]))


def _attention(b: Builder, tokens: str, layer: Tree) -> str:
    """Single-head self-attention over (n, C)."""
    kernels, biases = (np.split(np.asarray(layer["qkv"][name]), 3, axis=-1) for name in ("kernel", "bias"))
    parts = [b.dense(tokens, {"kernel": k, "bias": v}) for k, v in zip(kernels, biases, strict=True)]
    scores = b.op("MatMul", parts[0], b.op("Transpose", parts[1], perm=[1, 0]))
    scores = b.op("Mul", scores, b.constant(kernels[0].shape[-1] ** -0.5))
    return b.dense(b.op("MatMul", b.op("Softmax", scores, axis=-1), parts[2]), layer["output"])


def _transformer(b: Builder, tokens: str, layers: Tree) -> str:
    """Post-norm encoder layers over (n, C)."""
    for i in range(len(layers)):
        layer = layers[f"layer_{i}"]
        attended = _attention(b, tokens, layer["attention"])
        tokens = b.layer_norm(b.op("Add", tokens, attended), layer["norm_attention"])
        mixed = b.dense(b.op("Relu", b.dense(tokens, layer["mlp_in"])), layer["mlp_out"])
        tokens = b.layer_norm(b.op("Add", tokens, mixed), layer["norm_mlp"])
    return tokens


def _mean_token(b: Builder, tokens: str) -> str:
    return b.op("ReduceMean", tokens, axes=[0], keepdims=0)


def _loco_transformer(b: Builder, params: Tree, config: Config, state: str) -> str:
    body = b.op("Relu", b.dense(b.mlp(state, params["state_encoder"]), params["state_token"]))
    features = _depth_encoder(b, params["depth_encoder"])
    visual = _visual_tokens(b, features, params["visual_tokens"], config.network.tokens_per_side)
    tokens = b.op("Concat", b.op("Unsqueeze", body, b.constant([0], np.int64)), visual, axis=0)
    tokens = _transformer(b, tokens, params.get("policy_transformer", {}))
    first = b.op("Gather", tokens, b.constant(0, np.int64), axis=0)
    start, end = b.constant([1], np.int64), b.constant([np.iinfo(np.int64).max], np.int64)
    rest = b.op("Slice", tokens, start, end, b.constant([0], np.int64))
    return b.op("Concat", first, _mean_token(b, rest), axis=0)


def _depth_only(b: Builder, params: Tree, config: Config, state: str) -> str:
    features = _depth_encoder(b, params["depth_encoder"])
    tokens = _visual_tokens(b, features, params["visual_tokens"], config.network.tokens_per_side)
    return _mean_token(b, _transformer(b, tokens, params.get("policy_transformer", {})))


def _state_depth_concat(b: Builder, params: Tree, config: Config, state: str) -> str:
    return b.op("Concat", _flat_visual(b, params), b.mlp(state, params["state_encoder"]), axis=0)


def _visual_cnn(b: Builder, params: Tree, config: Config, state: str) -> str:
    return _flat_visual(b, params)


def _hierarchical(b: Builder, params: Tree, config: Config, state: str) -> str:
    command = b.op("Tanh", b.dense(_flat_visual(b, params), params["policy_command"]))
    return b.op("Concat", b.mlp(state, params["state_encoder"]), command, axis=0)


def _state_only(b: Builder, params: Tree, config: Config, state: str) -> str:
    return b.mlp(state, params["state_encoder"])


# What a policy's head decides on: (features,) from the normalised state and `depth`. A policy that is not here is
# written by jax2onnx (loco_mjx/deploy/converted.py), as a graph some times as large.
FEATURES: dict[str, Callable[[Builder, Tree, Config, str], str]] = {
    "loco-transformer": _loco_transformer,
    "state-only": _state_only,
    "depth-only": _depth_only,
    "state-depth-concat": _state_depth_concat,
    "visual-cnn": _visual_cnn,
    "hrl": _hierarchical,
}


@dataclass(frozen=True)
class Ends:
    """What stands before and after the networks.

    Attributes:
        mean: (n,) of `state`.
        std: (n,) of `state`.
        clip: of the normalised state, standard deviations.
        shapes: of the inputs the policy reads, by name.
        neutral: (n,) what an action of 0 stands for: of joint targets the default pose, rad.
        scale: (n,) what an action of 1 adds.
        controller: that takes it.
    """

    mean: np.ndarray
    std: np.ndarray
    clip: float
    shapes: dict[str, tuple[int, ...]]
    neutral: np.ndarray
    scale: np.ndarray
    controller: Controller


def build(config: Config, params: Tree, ends: Ends) -> Any:
    """The ONNX model of a policy in FEATURES.

    Args:
        config: of the run.
        params: the module's parameters, without Flax's outer `params`.
        ends: normalisation, inputs and the action's meaning.
    """
    b = Builder()
    state = _normalized(b, ends) if STATE in ends.shapes else ""
    features = FEATURES[config.policy](b, params, config, state)
    action = b.op("Tanh", b.head(features, params["policy_head"]["mean"]))
    if config.env.action.diagonal and ends.controller.scale is None:
        action = b.op("Gather", action, b.constant(list(DIAGONAL), np.int64), axis=0)
    scaled = b.op("Mul", action, b.constant(ends.scale))
    b.op("Add", scaled, b.constant(ends.neutral))
    return _model(b, ends)


def _normalized(b: Builder, ends: Ends) -> str:
    centred = b.op("Sub", STATE, b.constant(ends.mean))
    return b.op("Clip", b.op("Div", centred, b.constant(ends.std)), b.constant(-ends.clip), b.constant(ends.clip))


def _model(b: Builder, ends: Ends) -> Any:
    import onnx
    from onnx import TensorProto, helper

    name, size = ends.controller.output, ends.controller.size
    b.nodes[-1].output[0] = name
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in ends.shapes.items()]
    output = helper.make_tensor_value_info(ends.controller.output, TensorProto.FLOAT, (size,))
    graph = helper.make_graph(b.nodes, "policy", inputs, [output], b.weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="loco-mjx")
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model
