"""A policy folder: what its files are, and the checks it has to pass before anything is done with it.

- ``policy.json``: everything a runner has to know (written by loco_mjx/deploy/export.py)
- ``policy.onnx``: observation in; joint targets (rad), or what else the controller takes, out
- ``policy.npz``: the raw parameters and the normaliser
- ``policy.stablehlo``: the same function by `jax.export`
- ``robot.xml``: the robot's MJCF, where it is none of those that come with the package
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loco_mjx import controllers
from loco_mjx.controllers import Controller, get_controller
from loco_mjx.deploy import schema, strict_json
from loco_mjx.deploy.description import DEPTH, FORMAT, STATE, VERSION
from loco_mjx.errors import UserError
from loco_mjx.robots import DEFAULT, NJOINT, get_robot

MANIFEST, ONNX, PARAMETERS, STABLEHLO = "policy.json", "policy.onnx", "policy.npz", "policy.stablehlo"
ROBOT = "robot.xml"


@dataclass(frozen=True)
class Field:
    """One sensor's part of `state`.

    Attributes:
        name: displacement, imu, last_action, angles or goal.
        size: numbers per frame.
        frames: how many frames, newest first.
    """

    name: str
    size: int
    frames: int


@dataclass(frozen=True)
class Camera:
    """The depth camera the policy was trained with; see DepthConfig. Angles in degrees, lengths in metres."""

    height: int
    width: int
    vertical_fov: float
    horizontal_fov: float
    near: float
    far: float
    frames: int
    offset: tuple[float, float, float]  # in the trunk's frame
    code_offset: float  # code = (sqrt(ln(d + 1)) − code_offset) / code_scale
    code_scale: float


@dataclass(frozen=True)
class Manifest:
    """What ``policy.json`` says, checked.

    Attributes:
        policy: the policy's name.
        robot: its robot's name.
        body: what `get_robot` finds it by: its name, or the MJCF in the folder.
        fields: the parts of `state` in order; empty if it is not read.
        camera: None if depth is not read.
        joints: names in the order of every vector of 12.
        default_pose: (12,) rad.
        lower: (12,) rad.
        upper: (12,) rad.
        torque_limit: (12,) N·m.
        kp: N·m/rad.
        kd: N·m·s/rad.
        policy_hz: ticks per second.
        pd_hz: commands per second, a multiple of policy_hz.
        hold: ticks for which the depth given is held.
        controller: what its output is for.
        raw: the whole file.
    """

    policy: str
    robot: str
    body: str
    fields: tuple[Field, ...]
    camera: Camera | None
    joints: tuple[str, ...]
    default_pose: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    torque_limit: np.ndarray
    kp: float
    kd: float
    policy_hz: int
    pd_hz: int
    hold: int
    controller: Controller
    raw: Mapping[str, Any]

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the inputs that are read."""
        return {name: tuple(part["shape"]) for name, part in self.raw["inputs"].items()}

    def reads(self, name: str) -> bool:
        """Whether `state` has a field of that name."""
        return any(field.name == name for field in self.fields)


def digest(path: Path) -> str:
    """A file's SHA-256, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read(folder: Path) -> Manifest:
    """The manifest of a policy folder, after checking that its files are there and the ones it speaks of.

    Raises:
        UserError: if anything is missing, unknown, damaged, of another version, not this robot's, or not what the
            manifest says.
    """
    raw = _load(folder)
    if raw.get("format") != FORMAT:
        raise UserError(f"{folder / MANIFEST} is not a policy of loco-mjx; give a folder that `loco-mjx export` wrote")
    if raw.get("format_version") != VERSION:
        raise UserError(
            f"{folder / MANIFEST} is of format version {raw.get('format_version')!s:.20}, this loco-mjx reads "
            f"{VERSION}; export the run again with this version"
        )
    body = folder / ROBOT if isinstance(raw.get("files"), dict) and ROBOT in raw["files"] else None
    try:
        schema.check(raw, None if body is None else get_robot(str(body)))
    except UserError as error:
        raise UserError(f"{folder / MANIFEST} cannot be used: {error}; export the run again") from error
    _check_files(folder, {name: str(about["sha256"]) for name, about in raw["files"].items()})
    return build(raw, body)


def parameters(folder: Path, manifest: Manifest) -> dict[str, np.ndarray]:
    """The raw parameters by their path, and the normaliser's `normalizer/mean` and `normalizer/std`.

    Args:
        folder: of the policy.
        manifest: its own, from :func:`read`, which has compared the files that it describes.

    Raises:
        UserError: if they are missing, or the manifest does not describe them.
    """
    path = folder / PARAMETERS
    if not path.is_file() or PARAMETERS not in manifest.raw["files"]:
        raise UserError(f"{folder} has no {PARAMETERS} that its {MANIFEST} describes; export the run again")
    with np.load(path) as arrays:
        return dict(arrays)


def _load(folder: Path) -> dict[str, Any]:
    if not folder.is_dir():
        raise UserError(f"there is no policy folder {folder}; `loco-mjx export DIR --out {folder}` writes one")
    path = folder / MANIFEST
    if not path.is_file():
        raise UserError(f"{folder} has no {MANIFEST}; give a folder that `loco-mjx export` wrote")
    try:
        raw = strict_json.parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read ({error}); export the run again") from error
    if not isinstance(raw, dict):
        raise UserError(f"{path} holds no policy; export the run again")
    return raw


def build(raw: Mapping[str, Any], body: Path | None = None) -> Manifest:
    """What a manifest says that has been checked; `body` is the MJCF in its folder, if there is one."""
    inputs, joints, gains, rates = raw["inputs"], raw["joints"], raw["gains"], raw["rates"]
    fields = inputs[STATE]["fields"] if STATE in inputs else []
    camera = None
    if DEPTH in inputs:
        keys = Camera.__dataclass_fields__
        values = {name: value for name, value in inputs[DEPTH]["camera"].items() if name in keys}
        offset = values["offset"]  # its x alone, where y and z are 0
        camera = Camera(**values | {"offset": tuple(offset) if isinstance(offset, list) else (offset, 0.0, 0.0)})
    return Manifest(
        policy=str(raw["policy"]),
        robot=str(raw.get("robot", DEFAULT)),
        body=str(body or raw["config"]["env"].get("robot", DEFAULT)),
        fields=tuple(Field(str(part["name"]), int(part["size"]), int(part["frames"])) for part in fields),
        camera=camera,
        joints=tuple(joints["order"]),
        default_pose=np.array(joints["default_pose"], np.float64),
        lower=np.array(joints["lower"], np.float64),
        upper=np.array(joints["upper"], np.float64),
        torque_limit=np.broadcast_to(np.array(joints["torque_limit"], np.float64), NJOINT),
        kp=float(gains["kp"]),
        kd=float(gains["kd"]),
        policy_hz=int(rates["policy_hz"]),
        pd_hz=int(rates["pd_hz"]),
        hold=int(raw["hold"]),
        controller=get_controller(str(raw.get("controller", controllers.DEFAULT))),
        raw=raw,
    )


def _check_files(folder: Path, recorded: Mapping[str, str]) -> None:
    """The files are those that are described; all but what a robot needs, the ONNX file and its MJCF, may be absent."""
    for name, wanted in recorded.items():
        path = folder / name
        if not path.is_file() and name in (ONNX, ROBOT):
            raise UserError(f"{folder} has no {name}; export the run again")
        if path.is_file() and digest(path) != wanted:
            raise UserError(f"{path} is not the file that {MANIFEST} describes; export the run again")
