"""Whether ``policy.json`` is one: a JSON Schema that holds the robot's own data, its own hash, its configuration."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from loco_mjx import controllers
from loco_mjx.config import Config, from_dict
from loco_mjx.controllers import Controller, get_controller
from loco_mjx.deploy import description
from loco_mjx.deploy.description import DEPTH, SEAL, STATE
from loco_mjx.errors import UserError
from loco_mjx.robots import DEFAULT, Robot, get_robot, joint_names

ROBOT = "robot"  # the key; a manifest without it is of an A1
CONTROLLER = "controller"  # likewise; one without it is of joint targets
LONGEST = 160  # characters that are shown of a value and of what is accepted, either of which may be a long list
# Words for people: another version may find better ones for the same thing.
WORDS = ("meaning", "depth", "order")


def check(raw: Mapping[str, Any], own: Robot | None = None) -> None:
    """Checks all that a manifest says: its fields and their values, its hash, and that they fit its configuration.

    Args:
        raw: the manifest.
        own: its robot, where its folder has one; else it is looked up by its name.

    Raises:
        UserError: naming what is wrong, in one line.
        ModuleNotFoundError: without the `deploy` extra.
    """
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    (robot, named), (controller, led) = _robot(raw, own), _controller(raw)
    optional = (*(() if named else (ROBOT,)), *(() if led else (CONTROLLER,)))
    error = best_match(Draft202012Validator(schema(robot, controller, optional)).iter_errors(raw))
    if error is not None:
        raise UserError(_complaint(error))
    if raw[SEAL] != description.sealed(raw):
        raise UserError("it was changed after it was written: its hash is another")
    config = from_dict(Config, raw["config"])
    if raw["hold"] not in (1, config.network.hold):
        raise UserError(f"hold is {raw['hold']}; accepted: 1 or the configuration's {config.network.hold}")
    if raw["config_hash"] != description.config_hash(raw["config"]):
        raise UserError("config_hash is not its configuration's")
    # As the file has it: keys that this version knows and the one that wrote it did not are no difference.
    wanted = description.describe(config, raw["inputs"], raw["hold"], robot)
    found = {ROBOT: DEFAULT, CONTROLLER: controllers.DEFAULT} | dict(raw)
    differs = _difference(found, wanted | {key: raw[key] for key in ("config", "config_hash")})
    if differs is None and raw["training"]["task"] != config.env.task:
        differs = "training.task", raw["training"]["task"], config.env.task
    if differs is not None:
        name, value, accepted = differs
        raise UserError(f"{name} is {_short(value)}; accepted, for its configuration: {_short(accepted)}")


def _complaint(error: Any) -> str:
    """A schema's error in one line: where, what is there, and what is accepted."""
    place = ".".join(map(str, error.absolute_path)) or "policy.json"
    if error.validator in ("required", "additionalProperties"):
        return f"{place}: {error.message:.{LONGEST}}"
    accepted = {"const": "", "enum": "one of ", "type": "a value of type ", "pattern": "text like "}
    kind = accepted.get(error.validator, f"{error.validator} ")
    return f"{place} is {_short(error.instance)}; accepted: {kind}{_short(error.validator_value)}"


def _difference(found: Any, wanted: Any, name: str = "") -> tuple[str, Any, Any] | None:
    """The first place where what was found is not what is wanted: its name and both; what is not wanted is free."""
    if isinstance(wanted, dict) and isinstance(found, Mapping):
        for key, value in wanted.items():
            if key in WORDS and isinstance(value, str):
                continue
            part = f"{name}.{key}" if name else key
            differs = _difference(found[key], value, part) if key in found else (part, "missing", value)
            if differs is not None:
                return differs
        return None
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        pairs = enumerate(zip(found, wanted, strict=True))
        return next((d for i, (a, b) in pairs if (d := _difference(a, b, f"{name}.{i}")) is not None), None)
    return None if found == wanted else (name, found, wanted)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST else text[:LONGEST] + " …"


# The schema --------------------------------------------------------------------------------------------------------

_TEXT = {"type": "string", "maxLength": 1000}
_NAME = {"type": "string", "minLength": 1, "maxLength": 200}
_HASH = {"type": "string", "pattern": "^[0-9a-f]{64}$"}


def _object(properties: Mapping[str, Any], optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """An object with these keys and no others."""
    required = [name for name in properties if name not in optional]
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _numbers(count: int, low: float, high: float) -> dict[str, Any]:
    return {"type": "array", "items": _number(low, high), "minItems": count, "maxItems": count}


def _number(low: float, high: float, kind: str = "number") -> dict[str, Any]:
    return {"type": kind, "minimum": low, "maximum": high}


def _robot(raw: Mapping[str, Any], own: Robot | None) -> tuple[Robot, bool]:
    """The robot of a manifest's configuration, and whether that names one: those written before others came do not.

    Raises:
        UserError: if it is unknown here, or the manifest names another.
    """
    configuration = raw.get("config")
    env = configuration.get("env") if isinstance(configuration, Mapping) else None
    name = env.get(ROBOT) if isinstance(env, Mapping) else None
    robot = own or get_robot(name if isinstance(name, str) else DEFAULT)
    if raw.get(ROBOT, robot.name) != robot.name:
        raise UserError(f"robot is {_short(raw[ROBOT])}; accepted, for its configuration: {_short(robot.name)}")
    return robot, name is not None


def _controller(raw: Mapping[str, Any]) -> tuple[Controller, bool]:
    """The controller that a manifest names, and whether its configuration has one: those of before there were more not.

    Raises:
        UnknownNameError: if it is unknown here.
    """
    env = raw["config"].get("env") if isinstance(raw.get("config"), Mapping) else None
    named = isinstance(env, Mapping) and CONTROLLER in env
    return get_controller(str(raw.get(CONTROLLER, controllers.DEFAULT))), named


def schema(robot: Robot, controller: Controller, optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """The JSON Schema of ``policy.json``: what the robot is, as it is; what a policy may choose, in its ranges.

    `optional` are the keys that it need not have.
    """
    joints = {
        "order": {"const": list(joint_names())},
        "default_pose": {"const": list(robot.default_pose)},
        "lower": {"const": list(robot.lower)},
        "upper": {"const": list(robot.upper)},
        "torque_limit": {"const": _plain(description.torque_limit(robot))},
    }
    rates = {"policy_hz": {"const": controller.rate(robot)}, "pd_hz": {"const": round(1 / robot.physics_dt)}}
    files = dict.fromkeys(("policy.onnx", "policy.npz", "policy.stablehlo", "robot.xml"), _object({"sha256": _HASH}))
    action: dict[str, Any] = {"scale": _numbers(3, 0, math.pi), "diagonal": {"type": "boolean"}}
    if controller.scale is not None:
        action = {"scale": {"const": list(controller.scale)}}
    action |= {"included_in_onnx": {"const": True}}
    outputs = {
        name: _object({key: _TEXT if key == "meaning" else {"const": value} for key, value in about.items()})
        for name, about in description.outputs(controller).items()
    }
    return _object(
        {
            "format": {"const": description.FORMAT},
            "format_version": {"const": description.VERSION},
            "policy": _NAME,
            ROBOT: {"const": robot.name},
            CONTROLLER: {"const": controller.name},
            "inputs": _object({STATE: _state(), DEPTH: _depth(robot)}, (STATE, DEPTH)) | {"minProperties": 1},
            "outputs": _object(outputs),
            "joints": _object(joints),
            "gains": _object({"kp": _number(0, 500), "kd": _number(0, 50), "unit": {"const": "N·m/rad, N·m·s/rad"}}),
            "rates": _object(rates),
            "action": _object(action),
            "hold": _number(1, 1000, "integer"),
            "latency": _object({"trained_with": _numbers(2, 0, 1 / controller.rate(robot)), "unit": {"const": "s"}}),
            "training": _object(
                {
                    "task": _NAME,
                    "samples": _number(0, 2**31, "integer"),
                    "evaluation": {"anyOf": [_NONE, _evaluation()]},
                }
            ),
            "config_hash": _HASH,
            "config": {"type": "object"},  # its own types and ranges are looked at by loco_mjx.config
            "versions": {"type": "object", "additionalProperties": _TEXT},
            "files": _object(files, ("policy.npz", "policy.stablehlo", "robot.xml")),
            SEAL: _HASH,
        },
        optional,
    )


def _plain(value: float | tuple[float, ...]) -> Any:
    """As JSON has it."""
    return list(value) if isinstance(value, tuple) else value


_NONE = {"type": "null"}


def _state() -> dict[str, Any]:
    known = description.fields()
    sizes, units, _ = zip(*known.values(), strict=True)
    field = {
        "name": {"enum": list(known)},
        "offset": _number(0, 10_000, "integer"),
        "size": _number(1, max(sizes), "integer"),
        "frames": _number(1, 64, "integer"),
        "order": {"const": description.NEWEST_FIRST},
        "unit": {"enum": sorted(set(units))},
        "meaning": _TEXT,
    }
    fields = {"type": "array", "items": _object(field), "minItems": 1, "maxItems": len(known)}
    size = {"type": "array", "items": _number(1, 10_000, "integer"), "minItems": 1, "maxItems": 1}
    return _object({"shape": size, "normalised": {"const": False}, "fields": fields})


def _depth(robot: Robot) -> dict[str, Any]:
    camera = {
        "height": _number(1, 1024, "integer"),
        "width": _number(1, 1024, "integer"),
        "vertical_fov": _number(0, 180),
        "horizontal_fov": _number(0, 180),
        "near": _number(0, 1000),
        "far": _number(0, 1000),
        "frames": _number(1, 64, "integer"),
        "offset": {"const": _plain(description.camera_offset(robot))},
        "code_offset": {"const": description.CODE_OFFSET},
        "code_scale": {"const": description.CODE_SCALE},
    }
    shape = {"type": "array", "items": _number(1, 1024, "integer"), "minItems": 3, "maxItems": 3}
    words = {"order": _TEXT, "depth": _TEXT, "encoding": {"const": description.ENCODING}}
    return _object({"shape": shape, **words, "camera": _object(camera)})


def _evaluation() -> dict[str, Any]:
    figures = _object({"mean": {"type": "number"}, "std": {"type": "number"}})
    return _object(
        {
            "task": _NAME,
            "num_episodes": _number(1, 1_000_000, "integer"),
            "seed": _number(0, 2**31, "integer"),
            "samples": _number(0, 2**31, "integer"),
            "randomized": {"type": "boolean"},
            "metrics": {"type": "object", "additionalProperties": figures},
        }
    )
