"""The ONNX graph of a policy that loco_mjx/deploy/graph.py does not know: jax2onnx writes it, and it has to agree."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jp
import numpy as np

from loco_mjx.controllers import Controller
from loco_mjx.deploy.description import STATE
from loco_mjx.errors import UserError

OPSET, IR_VERSION = 21, 10  # the oldest that has what jax2onnx writes; onnxruntime 1.18 reads it
TOLERANCE = 1e-4  # rad, or the unit of what the controller takes, between the graph and the policy
SAMPLES = 64
Targets = Callable[..., jax.Array]
Shapes = Mapping[str, tuple[int, ...]]


def convert(
    name: str, targets: Targets, shapes: Shapes, mean: np.ndarray, std: np.ndarray, controller: Controller
) -> Any:
    """The ONNX model of a function, compared with it on random observations.

    Args:
        name: of the policy, for messages.
        targets: from observations with leading axes (...) to joint targets (..., 12), rad, or what `controller` takes.
        shapes: of what it reads, in order, without leading axes.
        mean: (n,) of `state`, to draw it by.
        std: (n,) likewise.
        controller: that takes the output.

    Raises:
        UserError: if jax2onnx is missing or cannot write it, or what it wrote differs.
    """
    model = written(name, targets, shapes, controller.output)
    difference = disagreement(model, targets, observations(shapes, mean, std))
    if not difference <= TOLERANCE:  # NaN is no agreement
        raise UserError(
            f"the ONNX graph of policy '{name}' differs from it by {difference:.1e} {controller.unit}; "
            f"accepted: {TOLERANCE:g}"
        )
    return model


def written(name: str, targets: Targets, shapes: Shapes, output: str) -> Any:
    """The ONNX model of a function as jax2onnx writes it, not yet compared; arguments as of `convert`.

    Raises:
        UserError: if jax2onnx is missing or cannot write it.
    """
    try:
        with _quiet():
            import jax2onnx
    except ImportError:
        raise UserError(
            f"exporting policy '{name}' needs the jax2onnx package; `pip install 'loco-mjx[export]'` installs it"
        ) from None

    def one(*arrays: jax.Array) -> jax.Array:
        return targets(*(array[None] for array in arrays))[0]  # products of vectors are written wrongly

    arguments = [jax.ShapeDtypeStruct(shape, jp.float32) for shape in shapes.values()]
    try:
        with _quiet():
            model = jax2onnx.to_onnx(
                one, arguments, model_name="policy", opset=OPSET, input_names=list(shapes), output_names=[output]
            )
    except Exception as error:  # whatever it meets in a module that it cannot write
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise UserError(f"jax2onnx cannot write policy '{name}': {lines[0]}") from error
    model.ir_version = IR_VERSION
    return model


def observations(shapes: Shapes, mean: np.ndarray, std: np.ndarray) -> dict[str, np.ndarray]:
    """(SAMPLES, ...) of each input: states as they were met in training, some of them far out; depth of any kind."""
    rng = np.random.default_rng(0)
    found = {name: rng.uniform(-3.0, 1.0, (SAMPLES, *shape)) for name, shape in shapes.items()}
    if STATE in found:
        far = rng.choice([1.0, 20.0], (SAMPLES, 1), p=[0.9, 0.1])
        found[STATE] = mean + far * std * rng.normal(size=found[STATE].shape)
    return {name: values.astype(np.float32) for name, values in found.items()}


def disagreement(model: Any, targets: Targets, obs: Mapping[str, np.ndarray]) -> float:
    """The largest difference between a graph, with one output, and the function it stands for.

    Raises:
        UserError: if onnxruntime is missing or does not take the graph.
    """
    try:
        import onnxruntime
    except ImportError:
        raise UserError("comparing needs onnxruntime; `pip install 'loco-mjx[export]'` installs it") from None
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no common base
        raise UserError(f"onnxruntime does not take the graph that jax2onnx wrote: {error}") from error
    count = len(next(iter(obs.values())))
    got = [session.run(None, {name: values[i] for name, values in obs.items()})[0] for i in range(count)]
    return float(np.max(np.abs(np.array(got) - np.asarray(jax.jit(targets)(*obs.values())))))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """jax2onnx warns of parts of its own that this JAX does not suit and that no policy needs."""
    logger = logging.getLogger("jax2onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
