"""What lies where a run, a policy's folder or a scene should, and is none."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path
from typing import Any

from loco_mjx import policies
from loco_mjx.config import Config, to_dict
from loco_mjx.deploy.description import sealed
from loco_mjx.deploy.folder import MANIFEST, ONNX, PARAMETERS

SHIPPED = policies.SHIPPED / policies.names()[0]
# Parts of a manifest in which any other number is wrong; elsewhere it is only another text or figure.
TOLD = ("inputs", "outputs", "joints", "gains", "rates", "action", "hold", "config_hash", "format_version")
NUMBERS = (1e9, -1e9, -1, 0.123, 10**30, 7)
NO_JSON = ("", "{", "[]", "null", "3", '"text"', '{"a": NaN}', '{"a": 1, "a": 2}', "[" * 5000, "{}", "\0", "\ufeff{}")
NAMES = ("\u200b", "größe", "日本語", "🤖", "../..", "-", "nan", "%s", "$HOME", "*", "a b", "\x1b[2J", "x" * 5000)


def folder(place: Path, numbers: random.Random) -> Path:
    """Something that is no run and no policy, at a path of its own; it may not exist."""
    return numbers.choice((missing, missing, junk, damaged_policy, damaged_policy, other_policy, damaged_run))(
        place / "given", numbers
    )


def missing(path: Path, numbers: random.Random) -> Path:
    """A path that does not exist, or leads nowhere."""
    loop = path.with_name("loop")
    loop.unlink(missing_ok=True)
    loop.symlink_to(loop)
    names = (*NAMES, "x" * 300, "a/" * 2000 + "b")
    strange = ("/dev/null", "/dev/null/x", "/proc/self/mem", "/nowhere/at/all", loop, loop / "x", "\udcff\udcfe", "~")
    return Path(numbers.choice((*strange, *(path / name for name in names))))


def junk(path: Path, numbers: random.Random) -> Path:
    """A file, an empty folder, or one with something else in it."""
    kind = numbers.randrange(4)
    if kind == 0:
        path.write_bytes(numbers.randbytes(100))
        return path
    path.mkdir()
    if kind > 1:
        name = numbers.choice(("config.json", "metrics.csv", "info.json", MANIFEST, ONNX, "checkpoints"))
        (path / name).mkdir() if kind == 2 else (path / name).write_text(numbers.choice(NO_JSON))
    return path


def damaged_policy(path: Path, numbers: random.Random) -> Path:
    """A shipped policy, one of whose files is not as it was written."""
    shutil.copytree(SHIPPED, path)
    file = path / numbers.choice((MANIFEST, MANIFEST, ONNX, PARAMETERS))
    content = file.read_bytes()
    kind = numbers.randrange(5)
    if kind == 0:
        file.write_bytes(content[: numbers.randrange(len(content))])
    elif kind == 1:
        file.write_bytes(numbers.randbytes(len(content)))
    elif kind == 2:
        file.write_text(numbers.choice(NO_JSON))
    elif kind == 3:
        place = numbers.randrange(len(content))
        # A digit or a letter of the description, any byte of the others.
        file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    else:
        (path / numbers.choice((MANIFEST, ONNX))).unlink()
    return path


def other_policy(path: Path, numbers: random.Random) -> Path:
    """A shipped policy whose description says something else of itself or of the robot, with a hash that fits."""
    shutil.copytree(SHIPPED, path)
    manifest = json.loads((path / MANIFEST).read_text())
    keys = numbers.choice([keys for keys in _leaves(manifest, ()) if keys != ("sha256",)])
    parent = manifest
    for key in keys[:-1]:
        parent = parent[key]
    old = parent[keys[-1]]
    number = isinstance(old, int | float) and not isinstance(old, bool)
    if number and keys[0] in TOLD and numbers.random() < 0.7:
        parent[keys[-1]] = numbers.choice([value for value in NUMBERS if value != old])
    elif numbers.random() < 0.2 and isinstance(parent, dict) and keys[0] not in ("versions", "training"):
        del parent[keys[-1]]
    else:
        parent[keys[-1]] = numbers.choice(([old], {"value": old}, "banana" if number else 12345))
    (path / MANIFEST).write_text(json.dumps(manifest | {"sha256": sealed(manifest)}))
    return path


def damaged_run(path: Path, numbers: random.Random) -> Path:
    """The directory of a run that has a configuration, and nothing else that is whole."""
    path.mkdir()
    config: Any = to_dict(Config(policy="state-only"))
    if numbers.random() < 0.5:
        keys = numbers.choice(list(_leaves(config, ())))
        parent = config
        for key in keys[:-1]:
            parent = parent[key]
        parent[keys[-1]] = numbers.choice(({}, {"a": 1}, [[]], "banana?", -1e30))
    (path / "config.json").write_text(json.dumps(config))
    for name in ("evaluation/thin-32-seed0.json", "metrics.csv", "checkpoints/000000000032/manifest.json"):
        if numbers.random() < 0.7:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_text(numbers.choice(NO_JSON))
    if numbers.random() < 0.3:
        (path / "info.json").write_text(numbers.choice(NO_JSON))
    return path


def scene(place: Path, numbers: random.Random) -> Path:
    """No MJCF of a scene with an A1."""
    path = place / "given.xml"
    texts = ("", "<mujoco/>", "<mujoco>", "<html/>", "{}", "<mujoco><worldbody><geom/></worldbody></mujoco>", "\0\0")
    path.write_text(numbers.choice(texts))
    return numbers.choice((path, path, missing(place / "given", numbers)))


def _leaves(tree: Any, keys: tuple[Any, ...]) -> Any:
    """The keys of every value in JSON."""
    parts = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = [leaf for key, value in parts for leaf in _leaves(value, (*keys, key))]
    return found or [keys]
