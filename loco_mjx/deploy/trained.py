"""An exported folder as the policy that it was made from: to evaluate it, to show it, to export it again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jp
import numpy as np
from flax import traverse_util

from loco_mjx.config import Config, from_dict
from loco_mjx.deploy import folder
from loco_mjx.errors import UserError
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import normalizer
from loco_mjx.run import needs
from loco_mjx.run.directory import CONFIG
from loco_mjx.run.policy import TrainedPolicy, load_policy, parameter_shapes

CRITIC_ONLY = ("critic/", "value_")  # parameters that no action depends on begin so


def is_exported(path: Path) -> bool:
    """Whether a folder is an exported policy, and not the directory of a run."""
    return (path / folder.MANIFEST).is_file() and not (path / CONFIG).exists()


def load(path: Path, step: int | str | None = None) -> TrainedPolicy:
    """The policy of the run in a directory, or the one in a folder that `loco-mjx export` wrote.

    Args:
        path: the directory, or the folder.
        step: which of a run's checkpoints to take, as for :func:`loco_mjx.run.policy.load_policy`.

    Raises:
        UserError: if there is no run and no policy, no checkpoint yet, or none that can be read.
    """
    if not is_exported(path):
        return load_policy(path, step)
    if step is not None:
        raise UserError(f"{path} holds one policy; accepted: --step for the directory of a run")
    manifest = folder.read(path)
    try:
        config = from_dict(Config, dict(manifest.raw["config"]))
        config = replace(config, env=replace(config.env, robot=manifest.body))
        samples = int(manifest.raw["training"]["samples"])
    except (UserError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path / folder.MANIFEST} is of another version ({error}); export the run again") from error
    needs.check(config, path)
    networks = make_networks(config.policy, config.network, config.env.action_size)
    arrays = folder.parameters(path, manifest)
    shapes = traverse_util.flatten_dict(parameter_shapes(config, networks)["params"], sep="/")
    named = {name: jp.asarray(_array(path, arrays, name, shape)) for name, shape in shapes.items()}
    params = {"params": traverse_util.unflatten_dict(named, sep="/")}
    known = normalizer.of(jp.asarray(arrays["normalizer/mean"]), jp.asarray(arrays["normalizer/std"]))
    return TrainedPolicy(config, networks, params, known, samples)


def _array(path: Path, arrays: dict[str, np.ndarray], name: str, shape: jax.ShapeDtypeStruct) -> np.ndarray:
    """One parameter; what only a critic reads may be left out of the folder, and is 0."""
    if name.startswith(CRITIC_ONLY) and name not in arrays:
        return np.zeros(shape.shape, shape.dtype)
    if name not in arrays or arrays[name].shape != shape.shape:
        raise UserError(f"{path / folder.PARAMETERS} has no '{name}' of shape {shape.shape}; export the run again")
    return arrays[name]
