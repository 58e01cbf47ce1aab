"""A flat scene and a policy folder made without JAX, and a policy that stands still."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from loco_mjx.config import Config, DepthConfig, EnvConfig, NetworkConfig, ObservationConfig
from loco_mjx.deploy import folder
from loco_mjx.deploy.description import config_hash, describe, sealed
from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.runner import Runner
from tests.known_robots import A1

SEEN = DepthConfig(height=8, width=8)
OBSERVED = ObservationConfig(depth=SEEN)
hashed = config_hash


def raw(hold: int = 1, **observed: bool) -> dict:
    """A manifest without files, and so without its hash; `observed` are keys of the observation."""
    env = EnvConfig(observation=ObservationConfig(depth=SEEN, **observed))
    config = Config(policy="made up", env=env, network=NetworkConfig(hold=hold))
    training = {"task": "thin", "samples": 8192, "evaluation": None}
    versions = {"loco-mjx": "0"}
    return describe(config, ("state", "depth"), hold) | {"training": training, "versions": versions, "files": {}}


def write(path: Path, changes: dict | None = None, content: bytes | None = None) -> Path:
    """A policy folder whose ONNX file (or `content`) adds nothing to the default pose, whatever it sees."""
    from onnx import TensorProto, helper, numpy_helper

    described = raw() | (changes or {})
    size = described["inputs"]["state"]["shape"][0] if isinstance(described.get("inputs"), dict) else 93
    pose = numpy_helper.from_array(np.array(A1.default_pose, np.float32), "pose")
    inputs = [
        helper.make_tensor_value_info("state", TensorProto.FLOAT, (size,)),
        helper.make_tensor_value_info("depth", TensorProto.FLOAT, (8, 8, 4)),
    ]
    output = helper.make_tensor_value_info("targets", TensorProto.FLOAT, (12,))
    node = helper.make_node("Identity", ["pose"], ["targets"])
    graph = helper.make_graph([node], "still", inputs, [output], [pose])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    (path / folder.ONNX).write_bytes(model.SerializeToString() if content is None else content)
    write_manifest(
        path, raw() | {"files": {folder.ONNX: {"sha256": folder.digest(path / folder.ONNX)}}} | (changes or {})
    )
    return path


def write_manifest(path: Path, content: dict) -> None:
    """A manifest that says so of itself, whatever it says."""
    (path / folder.MANIFEST).write_text(json.dumps(content | {"sha256": sealed(content)}))


def manifest(hold: int = 1) -> folder.Manifest:
    """The same, as it is read."""
    return folder.build(raw(hold))


@cache
def xml() -> str:
    """The scene below, as MJCF."""
    spec = mujoco.MjSpec.from_file(str(A1.path))
    seen = {"contype": 2, "conaffinity": 1, "group": 2}
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], **seen)
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="obstacle_0", type=box, size=[0.5, 5, 1], pos=[3.5, 0, 1], **seen)
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    hidden = {"contype": 0, "conaffinity": 0, "group": 2}
    spec.worldbody.add_geom(name="sphere_0", type=sphere, size=[0.1, 0, 0], pos=[0.1, 0, 1.5], **hidden)
    spec.compile()
    return spec.to_xml()


def model() -> mujoco.MjModel:
    """The A1 on a plane, a wall 3 m ahead of the origin, a sphere to collect above it."""
    return mujoco.MjModel.from_xml_string(xml())


def still(obs: dict[str, np.ndarray]) -> np.ndarray:
    """The policy that stands."""
    return np.array(A1.default_pose)


def clock():
    """No time passes for the policy, however busy the machine."""
    return 0.0


def runner(robot: MujocoRobot, policy=still, **more) -> Runner:
    return Runner(manifest(), policy, robot, **({"clock": clock} | more))
