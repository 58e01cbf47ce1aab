"""Writes a run's policy as a folder that explains itself and runs without JAX; see loco_mjx/deploy/folder.py."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from flax import traverse_util

from loco_mjx import a1
from loco_mjx.config import ObservationConfig, to_dict
from loco_mjx.deploy import folder, graph, trained
from loco_mjx.deploy.folder import DEPTH, STATE
from loco_mjx.depth import encoding
from loco_mjx.env import observation as obs_lib
from loco_mjx.errors import UserError
from loco_mjx.evaluation.policy import TrainedPolicy, observation_shapes
from loco_mjx.networks.policies import DEPTH as DEPTH_KEY
from loco_mjx.networks.policies import STATE as STATE_KEY
from loco_mjx.ppo import normalizer as normalizer_lib
from loco_mjx.ppo.inference import make_inference
from loco_mjx.run import about
from loco_mjx.run.directory import write_json

PLATFORMS = ("cpu", "cuda", "tpu")  # the StableHLO artefact runs on
KEYS = {STATE: STATE_KEY, DEPTH: DEPTH_KEY}  # the environment's name of each input
# What each field of `state` is: unit and meaning.
FIELDS: dict[str, tuple[str, str]] = {
    "displacement": ("m", "base displacement x, y, z over the last control step, world frame"),
    "imu": ("rad, rad, rad/s, rad/s", "roll, pitch, roll rate, pitch rate; rates in the trunk's frame"),
    "last_action": ("rad", "last joint targets minus the default pose, in the order of the joints"),
    "angles": ("rad", "joint angles, in the order of the joints"),
    "goal": ("m", "vector from the base to the goal, turned into the base's heading"),
}


def export(run: Path, out: Path) -> dict[str, Any]:
    """Writes the newest policy of a run.

    Args:
        run: the run's directory, or the folder of a policy that was exported.
        out: folder to write; made if it does not exist.

    Returns:
        What ``policy.json`` holds.

    Raises:
        UserError: if there is no usable run, the onnx package is missing, or the folder holds something else.
    """
    _check_out(out)
    _check_onnx_installed()
    return write(trained.load(run), out, latest_evaluation(run))


def write(policy: TrainedPolicy, out: Path, evaluation: dict[str, Any] | None = None) -> dict[str, Any]:
    """Writes a policy's folder; see :func:`export`. The manifest comes last, so that half a folder has none."""
    model = onnx_model(policy)
    contents = {
        folder.ONNX: model.SerializeToString(),
        folder.STABLEHLO: stablehlo(policy),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / folder.MANIFEST).unlink(missing_ok=True)
        for name, content in contents.items():
            (out / name).write_bytes(content)
        np.savez(out / folder.PARAMETERS, **raw_parameters(policy))  # type: ignore[arg-type]
    except OSError as error:
        raise UserError(f"cannot write into {out}: {error.strerror or error}; choose another --out") from error
    manifest = describe(policy, evaluation)
    manifest["files"] = {name: {"sha256": folder.digest(out / name)} for name in (*contents, folder.PARAMETERS)}
    write_json(out / folder.MANIFEST, manifest)
    return manifest


def _check_out(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is a file; choose a folder for --out")
    known = {folder.MANIFEST, folder.ONNX, folder.PARAMETERS, folder.STABLEHLO}
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
    """The policy in JAX: (..., n) `state` and (..., H, W, frames) `depth`, as read, to (..., 12) targets in rad."""
    act = make_inference(policy.networks, policy.params, policy.normalizer)
    names = tuple(inputs(policy))
    size = policy.config.env.observation.state_size

    def targets(*arrays: jax.Array) -> jax.Array:
        obs = {KEYS[name]: array for name, array in zip(names, arrays, strict=True)}
        if STATE_KEY not in obs:  # whoever reads depth alone
            obs[STATE_KEY] = jp.zeros((*obs[DEPTH_KEY].shape[:-3], size))
        action = act(obs, jax.random.PRNGKey(0))
        if policy.config.env.action.diagonal:
            right, left = action[..., :3], action[..., 3:]
            action = jp.concatenate([right, left, left, right], axis=-1)
        return jp.array(a1.DEFAULT_POSE) + jp.tile(jp.array(policy.config.env.action.scale), 4) * action

    return targets


def stablehlo(policy: TrainedPolicy) -> bytes:
    """The function serialised by `jax.export`; `jax.export.deserialize(...).call(state, depth)` runs it."""
    from jax import export as jax_export

    arguments = [jax.ShapeDtypeStruct(shape, jp.float32) for shape in inputs(policy).values()]
    return bytes(jax_export.export(jax.jit(target_function(policy)), platforms=PLATFORMS)(*arguments).serialize())


def onnx_model(policy: TrainedPolicy) -> Any:
    """The function as an ONNX model."""
    ends = graph.Ends(
        mean=np.asarray(policy.normalizer.mean),
        std=np.asarray(normalizer_lib.std(policy.normalizer)),
        clip=normalizer_lib.CLIP,
        shapes=inputs(policy),
        default_pose=np.array(a1.DEFAULT_POSE),
        scale=np.tile(np.array(policy.config.env.action.scale), 4),
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
    """The manifest, but for the files."""
    config, env = to_dict(policy.config), policy.config.env
    text = json.dumps(config, sort_keys=True)
    randomization = env.randomization
    return {
        "format": folder.FORMAT,
        "format_version": folder.VERSION,
        "policy": policy.config.policy,
        "inputs": {name: _describe_input(policy, name) for name in inputs(policy)},
        "outputs": {folder.TARGETS: {"shape": [12], "unit": "rad", "meaning": "joint targets of the PD controller"}},
        "joints": {
            "order": a1.JOINTS,
            "default_pose": a1.DEFAULT_POSE,
            "lower": a1.JOINT_LOWER,
            "upper": a1.JOINT_UPPER,
            "torque_limit": a1.TORQUE_LIMIT,
        },
        "gains": {"kp": env.kp, "kd": env.kd, "unit": "N·m/rad, N·m·s/rad"},
        "rates": {"policy_hz": round(1 / a1.CONTROL_DT), "pd_hz": round(1 / a1.PHYSICS_DT)},
        "action": {"scale": env.action.scale, "diagonal": env.action.diagonal, "included_in_onnx": True},
        "hold": policy.networks.hold,
        "latency": {"trained_with": randomization.latency if randomization.enabled else (0.0, 0.0), "unit": "s"},
        "training": {"task": env.task, "samples": policy.samples, "evaluation": evaluation},
        "config_hash": hashlib.sha256(text.encode()).hexdigest(),
        "config": config,
        "versions": about.versions(),
    }


def _describe_input(policy: TrainedPolicy, name: str) -> dict[str, Any]:
    shape = inputs(policy)[name]
    if name == STATE:
        return {"shape": shape, "normalised": False, "fields": _fields(policy.config.env.observation)}
    camera = policy.config.env.observation.depth
    keys = ("height", "width", "vertical_fov", "horizontal_fov", "near", "far", "frames")
    return {
        "shape": shape,
        "order": "row 0 on top, column 0 on the left, frame 0 the newest, one per tick; copies at the start",
        "depth": "planar, along the optical axis, m; clipped to [near, far], misses and holes read far",
        "encoding": "(sqrt(ln(d + 1)) - code_offset) / code_scale",
        "camera": {key: getattr(camera, key) for key in keys}
        | {"offset": a1.CAMERA_OFFSET, "code_offset": encoding.OFFSET, "code_scale": encoding.SCALE},
    }


def _fields(config: ObservationConfig) -> list[dict[str, Any]]:
    sizes = {name: (size, config.state_frames) for name, size in obs_lib.sensors(config).items()}
    if config.goal:
        sizes["goal"] = (3, 1)
    fields, offset = [], 0
    for name, (size, frames) in sizes.items():
        unit, meaning = FIELDS[name]
        about_it = {"name": name, "offset": offset, "size": size, "frames": frames, "order": "newest first"}
        fields.append(about_it | {"unit": unit, "meaning": meaning})
        offset += size * frames
    return fields


def latest_evaluation(run: Path) -> dict[str, Any] | None:
    """The metrics of a run's newest evaluation, or those that an exported policy came with; None if there are none."""
    if trained.is_exported(run):
        return folder.read(run).raw["training"]["evaluation"]
    files = sorted((run / "evaluation").glob("*.json"), key=lambda path: path.stat().st_mtime)
    if not files:
        return None
    result = json.loads(files[-1].read_text())
    return {key: result[key] for key in ("task", "num_episodes", "seed", "samples", "randomized", "metrics")}
