"""Writes a run's policy as a folder that explains itself and runs without JAX; see loco_mjx/deploy/folder.py."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from flax import traverse_util

from loco_mjx.controllers import get_controller
from loco_mjx.deploy import converted, description, folder, graph, trained
from loco_mjx.deploy.description import DEPTH, STATE
from loco_mjx.env.action import neutral, numbers, scale
from loco_mjx.errors import UserError
from loco_mjx.networks.outputs import DEPTH as DEPTH_KEY
from loco_mjx.networks.outputs import STATE as STATE_KEY
from loco_mjx.networks.registry import POLICIES
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.robots import ROBOTS, get_robot, is_path
from loco_mjx.run import provenance
from loco_mjx.run.directory import read_json, write_json
from loco_mjx.run.policy import TrainedPolicy, observation_shapes

PLATFORMS = ("cpu", "cuda", "tpu")  # the StableHLO artefact runs on
KEYS = {STATE: STATE_KEY, DEPTH: DEPTH_KEY}  # the environment's name of each input


def export(run: Path, out: Path, step: int | str | None = None) -> dict[str, Any]:
    """Writes the policy of a run.

    Args:
        run: the run's directory, or the folder of a policy that was exported.
        out: folder to write; made if it does not exist.
        step: which of the run's checkpoints, as for :func:`loco_mjx.run.policy.load_policy`.

    Returns:
        What ``policy.json`` holds.

    Raises:
        UserError: if there is no usable run, the onnx package is missing, or the folder holds something else.
    """
    _check_out(out)
    _check_onnx_installed()
    evaluation = latest_evaluation(run)
    policy = trained.load(run, step)
    if step is not None and evaluation is not None and evaluation["samples"] != policy.samples:
        evaluation = None  # of another checkpoint
    return write(policy, out, evaluation)


def write(
    policy: TrainedPolicy, out: Path, evaluation: dict[str, Any] | None = None, lean: bool = False
) -> dict[str, Any]:
    """Writes a policy's folder; see :func:`export`. The manifest comes last, so that half a folder has none.

    `lean` leaves out what acting does not need: StableHLO and the critic's parameters.
    """
    contents = {folder.ONNX: onnx_model(policy).SerializeToString()}
    contents |= {} if lean else {folder.STABLEHLO: stablehlo(policy)}
    robot = policy.config.env.robot
    if is_path(robot) or ROBOTS.origin(robot) is not None:  # where the policy goes, it may not be known
        contents[folder.ROBOT] = get_robot(robot).path.read_bytes()
    arrays = raw_parameters(policy)
    kept = {name: array for name, array in arrays.items() if not (lean and name.startswith(trained.CRITIC_ONLY))}
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / folder.MANIFEST).unlink(missing_ok=True)
        for name, content in contents.items():
            (out / name).write_bytes(content)
        np.savez(out / folder.PARAMETERS, **kept)  # type: ignore[arg-type]
    except OSError as error:
        raise UserError(f"cannot write into {out}: {error.strerror or error}; choose another --out") from error
    manifest = describe(policy, evaluation)
    manifest["files"] = {name: {"sha256": folder.digest(out / name)} for name in (*contents, folder.PARAMETERS)}
    manifest[description.SEAL] = description.sealed(manifest)
    write_json(out / folder.MANIFEST, manifest)
    return manifest


def _check_out(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is a file; choose a folder for --out")
    known = {folder.MANIFEST, folder.ONNX, folder.PARAMETERS, folder.STABLEHLO, folder.ROBOT}
    foreign = sorted(entry.name for entry in out.iterdir() if entry.name not in known) if out.exists() else []
    if foreign:
        raise UserError(f"{out} holds '{foreign[0]}', which is no part of a policy; choose a new folder for --out")


def _check_onnx_installed() -> None:
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise UserError("export needs the onnx package; `pip install 'loco-mjx[export]'` installs it") from None


# The function ---------------------------------------------------------------------------------------------------


def inputs(policy: TrainedPolicy) -> dict[str, tuple[int, ...]]:
    """Shapes of the inputs the policy reads: `state`, `depth` or both."""
    shapes = observation_shapes(policy.config)
    used = {STATE: policy.networks.uses_state, DEPTH: policy.networks.uses_depth}
    return {name: shapes[KEYS[name]] for name, yes in used.items() if yes}


def target_function(policy: TrainedPolicy) -> Callable[..., jax.Array]:
    """The policy in JAX: (..., n) `state` and (..., H, W, frames) `depth`, as read, to what its controller takes.

    That is (..., 12) joint targets in rad, or the whole-body controller's commands (..., 2).
    """
    actor = policy.actor()
    names = tuple(inputs(policy))
    config = policy.config.env
    size = config.observation.state_size

    def targets(*arrays: jax.Array) -> jax.Array:
        obs = {KEYS[name]: array for name, array in zip(names, arrays, strict=True)}
        if STATE_KEY not in obs:  # whoever reads depth alone
            obs[STATE_KEY] = jp.zeros((*obs[DEPTH_KEY].shape[:-3], size))
        action, _ = actor.act(obs)
        return jp.array(neutral(config)) + jp.array(scale(config)) * numbers(action, config)

    return targets


def stablehlo(policy: TrainedPolicy) -> bytes:
    """The function serialised by `jax.export`; `jax.export.deserialize(...).call(state, depth)` runs it."""
    from jax import export as jax_export

    arguments = [jax.ShapeDtypeStruct(shape, jp.float32) for shape in inputs(policy).values()]
    return bytes(jax_export.export(jax.jit(target_function(policy)), platforms=PLATFORMS)(*arguments).serialize())


def onnx_model(policy: TrainedPolicy) -> Any:
    """The function as an ONNX model.

    Raises:
        UserError: if the policy reads what only a simulator knows, or jax2onnx cannot write it.
    """
    name = policy.config.policy
    if POLICIES.find(name).uses_privileged:
        raise UserError(f"policy '{name}' has no ONNX graph: it reads what only a simulator knows")
    env = policy.config.env
    controller = get_controller(env.controller)
    if name not in graph.FEATURES:
        mean, std = (np.asarray(x) for x in (policy.normalizer.mean, normalizer_lib.std(policy.normalizer)))
        return converted.convert(name, target_function(policy), inputs(policy), mean, std, controller)
    ends = graph.Ends(
        mean=np.asarray(policy.normalizer.mean),
        std=np.asarray(normalizer_lib.std(policy.normalizer)),
        clip=normalizer_lib.CLIP,
        shapes=inputs(policy),
        neutral=neutral(env),
        scale=scale(env),
        controller=controller,
    )
    return graph.build(policy.config, jax.tree.map(np.asarray, policy.params["params"]), ends)


def raw_parameters(policy: TrainedPolicy) -> dict[str, np.ndarray]:
    """The parameters by their path (`policy_head/mean/output/kernel`), and the normaliser's mean and std."""
    flat = traverse_util.flatten_dict(policy.params["params"], sep="/")
    statistics = {"mean": policy.normalizer.mean, "std": normalizer_lib.std(policy.normalizer)}
    named = flat | {f"normalizer/{name}": value for name, value in statistics.items()}
    return {name: np.asarray(value) for name, value in named.items()}


# What it says of itself --------------------------------------------------------------------------------------------


def describe(policy: TrainedPolicy, evaluation: dict[str, Any] | None) -> dict[str, Any]:
    """The manifest, but for the files and its own hash."""
    described = description.describe(policy.config, list(inputs(policy)), policy.networks.hold)
    training = {"task": policy.config.env.task, "samples": policy.samples, "evaluation": evaluation}
    return described | {"training": training, "versions": provenance.versions()}


def _by_its_mean(result: Any) -> bool:
    """Whether an evaluation is of the deterministic policy, as exported ones are; what is damaged counts as one."""
    return not isinstance(result, dict) or result.get("deterministic", True)


def latest_evaluation(run: Path) -> dict[str, Any] | None:
    """The metrics of a run's newest evaluation by the mean of its actions, or those that an exported policy came with.

    None if there are none.

    Raises:
        UserError: if the file is damaged.
    """
    if trained.is_exported(run):
        return folder.read(run).raw["training"]["evaluation"]
    files = sorted((run / "evaluation").glob("*.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    newest = next(((path, read) for path in files if _by_its_mean(read := read_json(path))), None)
    if newest is None:
        return None
    path, result = newest
    try:
        found = {key: result[key] for key in ("task", "num_episodes", "seed", "samples", "randomized")}
        figures = {name: {key: float(of[key]) for key in ("mean", "std")} for name, of in result["metrics"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{path} is no evaluation ({error!r}); evaluate the run again, or remove it") from error
    sound = {name: of for name, of in figures.items() if all(map(math.isfinite, of.values()))}
    return found | {"metrics": sound}
