"""What ``policy.json`` says of a policy, as it follows from the run's configuration and its robot's own data.

Export writes it, and whoever reads a policy folder compares: the two cannot disagree on what a number means. It needs
no JAX.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from typing import Any

from loco_mjx.config import Config, DepthConfig, EnvConfig, ObservationConfig, to_dict
from loco_mjx.controllers import Controller, get_controller
from loco_mjx.robots import Robot, get_robot, joint_names
from loco_mjx.sensors import SENSORS, in_use

FORMAT, VERSION = "loco-mjx policy", 2
STATE, DEPTH = "state", "depth"
SEAL = "sha256"  # the manifest's own hash
GOAL = (3, "m", "vector from the base to the goal, turned into the base's heading")
NEWEST_FIRST = "newest first"
ENCODING = "(sqrt(ln(d + 1)) - code_offset) / code_scale"
CODE_OFFSET, CODE_SCALE = 1.25, 0.425


def fields() -> dict[str, tuple[int, str, str]]:
    """What each field of `state` is: size per frame, unit and meaning."""
    own = {name: (sensor.size, sensor.unit, sensor.meaning) for name, sensor in SENSORS.items()}
    return own | {"goal": GOAL}


def describe(config: Config, inputs: Collection[str], hold: int, robot: Robot | None = None) -> dict[str, Any]:
    """The part of the manifest that follows from the configuration, in JSON's types.

    Args:
        config: of the run.
        inputs: what the policy reads: `state`, `depth` or both.
        hold: ticks for which the depth that it is given is held.
        robot: that of the configuration, if it is at hand already.
    """
    env, robot = config.env, robot or get_robot(config.env.robot)
    controller = get_controller(env.controller)
    observation, randomization, plain = env.observation, env.randomization, to_dict(config)
    parts = {STATE: _state(observation), DEPTH: _depth(observation.depth, robot)}
    described = {
        "format": FORMAT,
        "format_version": VERSION,
        "policy": config.policy,
        "robot": robot.name,
        "controller": controller.name,
        "inputs": {name: part for name, part in parts.items() if name in inputs},
        "outputs": outputs(controller),
        "joints": {
            "order": joint_names(),
            "default_pose": robot.default_pose,
            "lower": robot.lower,
            "upper": robot.upper,
            "torque_limit": torque_limit(robot),
        },
        "gains": {"kp": env.kp, "kd": env.kd, "unit": "N·m/rad, N·m·s/rad"},
        "rates": {"policy_hz": controller.rate(robot), "pd_hz": round(1 / robot.physics_dt)},
        "action": _action(env, controller) | {"included_in_onnx": True},
        "hold": hold,
        "latency": {"trained_with": randomization.latency if randomization.enabled else (0.0, 0.0), "unit": "s"},
        "config_hash": config_hash(plain),
        "config": plain,
    }
    return json.loads(json.dumps(described))


def outputs(controller: Controller) -> dict[str, Any]:
    """What comes out of a controller's policies."""
    return {controller.output: {"shape": [controller.size], "unit": controller.unit, "meaning": controller.meaning}}


def _action(env: EnvConfig, controller: Controller) -> dict[str, Any]:
    """What an action in [−1, 1] stands for."""
    if controller.scale is not None:
        return {"scale": controller.scale}
    return {"scale": env.action.scale, "diagonal": env.action.diagonal}


def config_hash(config: Mapping[str, Any]) -> str:
    """SHA-256 of a configuration as JSON."""
    return hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()


def sealed(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of everything in a manifest but the hash itself, whatever the order and the spaces of its file."""
    rest = {key: value for key, value in manifest.items() if key != SEAL}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _state(config: ObservationConfig) -> dict[str, Any]:
    known = fields()
    frames = {name: 1 if name == "goal" else config.state_frames for name in known}
    names = [*in_use(config), *(["goal"] if config.goal else [])]
    parts: list[dict[str, Any]] = []
    offset = 0
    for name in names:
        size, unit, meaning = known[name]
        part = {"name": name, "offset": offset, "size": size, "frames": frames[name], "order": NEWEST_FIRST}
        parts.append(part | {"unit": unit, "meaning": meaning})
        offset += size * frames[name]
    return {"shape": [offset], "normalised": False, "fields": parts}


def torque_limit(robot: Robot) -> float | tuple[float, ...]:
    """N·m, as a manifest has it: one number where all motors have the same, else one for each."""
    return robot.torque_limit[0] if len(set(robot.torque_limit)) == 1 else robot.torque_limit


def camera_offset(robot: Robot) -> float | tuple[float, ...]:
    """The camera in the trunk's frame, m, as a manifest has it: its x where that is all, else x, y and z."""
    return robot.camera if any(robot.camera[1:]) else robot.camera[0]


def _depth(config: DepthConfig, robot: Robot) -> dict[str, Any]:
    keys = ("height", "width", "vertical_fov", "horizontal_fov", "near", "far", "frames")
    return {
        "shape": [config.height, config.width, config.frames],
        "order": "row 0 on top, column 0 on the left, frame 0 the newest, one per tick; copies at the start",
        "depth": "planar, along the optical axis, m; clipped to [near, far], misses and holes read far",
        "encoding": ENCODING,
        "camera": {key: getattr(config, key) for key in keys}
        | {"offset": camera_offset(robot), "code_offset": CODE_OFFSET, "code_scale": CODE_SCALE},
    }
