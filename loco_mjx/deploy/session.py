"""The exported policy, run by onnxruntime."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from loco_mjx.deploy.folder import ONNX, Manifest
from loco_mjx.errors import UserError

FLOAT = "tensor(float)"


class Session:
    """A function from `state` and `depth`, whichever the policy reads, to its output: joint targets, or commands."""

    def __init__(self, manifest: Manifest, folder: Path) -> None:
        """Loads ``policy.onnx`` and compares it with its description.

        Raises:
            UserError: if onnxruntime is missing, the file is damaged or does not match.
        """
        self._output = manifest.controller.output
        try:
            import onnxruntime
        except ImportError:
            raise UserError("deploy needs onnxruntime; `pip install 'loco-mjx[deploy]'` installs it") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # small networks; waiting threads would take the control loop's time
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(folder / ONNX), options, ["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors have no common base
            raise UserError(f"{folder / ONNX} cannot be loaded ({error}); export the run again") from error
        found = {part.name: (tuple(part.shape), part.type) for part in self._session.get_inputs()}
        wanted = {name: (shape, FLOAT) for name, shape in manifest.shapes.items()}
        outputs = {part.name: (tuple(part.shape), part.type) for part in self._session.get_outputs()}
        if found != wanted or outputs != {manifest.controller.output: ((manifest.controller.size,), FLOAT)}:
            raise UserError(f"{folder / ONNX} does not match its description: it has {found} → {outputs}, not {wanted}")

    def __call__(self, obs: Mapping[str, np.ndarray]) -> np.ndarray:
        """(12,) joint targets, rad, for one observation; or whatever else the controller takes."""
        return self._session.run([self._output], dict(obs))[0]
