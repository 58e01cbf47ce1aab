"""Every field of `policy.json` is checked against the robot's own data, the schema, the configuration and its hash."""

from __future__ import annotations

import copy
import json
from functools import reduce

import pytest

from loco_mjx.config import Config
from loco_mjx.deploy import description, folder, schema
from loco_mjx.depth import encoding
from loco_mjx.env import observation
from loco_mjx.errors import UserError
from loco_mjx.robots import joint_names
from tests.deploy import flat
from tests.known_robots import A1
from tests.refusals import refusal, says

# What is said for people, and what another run may have otherwise.
FREE = {"meaning", "depth", "order", "versions", "samples", "sha256", "evaluation"}
JUNK = (1e9, -1, "x", None, True, [], {})


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return flat.write(tmp_path_factory.mktemp("policy"))


@pytest.fixture
def manifest(policy):
    """What is in the folder, as it was written; and there again afterwards."""
    text = (policy / folder.MANIFEST).read_text()
    yield json.loads(text)
    (policy / folder.MANIFEST).write_text(text)


def refused(policy, content, seal=True):
    """What is said of a manifest that must be refused, in one line."""
    content = {key: value for key, value in content.items() if not seal or key != "sha256"}
    (policy / folder.MANIFEST).write_text(json.dumps(content))
    if seal:
        flat.write_manifest(policy, content)
    with pytest.raises(UserError) as found:
        folder.read(policy)
    assert "\n" not in str(found.value) and len(str(found.value)) < 1000
    return str(found.value)


def paths(tree, at=()):
    """The place of everything in a manifest but its whole."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield (*at, key)
        yield from paths(value, (*at, key))


def changed(manifest, path, value):
    tree = copy.deepcopy(manifest)
    reduce(lambda node, key: node[key], path[:-1], tree)[path[-1]] = value
    return tree


def test_nothing_that_is_written_may_be_otherwise(manifest):
    """Each value in turn becomes each piece of junk, in a manifest whose hash is right."""
    count = 0
    for path in paths(manifest):
        now = reduce(lambda node, key: node[key], path, manifest)
        free = FREE & set(path) and (isinstance(now, (str, int)) or now is None or path == ("versions",))
        if free or path[0] in ("config", "files"):  # which have tests of their own
            continue
        for value in JUNK:
            if value == now and isinstance(value, bool) == isinstance(now, bool):
                continue
            count += 1
            other = changed(manifest, path, value)
            with pytest.raises(UserError):
                schema.check(other | {"sha256": description.sealed(other)})
                pytest.fail(f"{path} is {value!r}")
    assert count > 500


def test_a_change_that_does_not_change_the_hash_is_found(policy, manifest):
    for path in (("training", "samples"), ("versions", "loco-mjx"), ("outputs", "targets", "meaning")):
        value = reduce(lambda node, key: node[key], path, manifest)
        other = changed(manifest, path, value + 1 if isinstance(value, int) else value + " ")
        assert says(refused(policy, other, seal=False), f"{folder.MANIFEST} hash")
    bare = {key: value for key, value in manifest.items() if key != "sha256"}
    assert says(refused(policy, bare, seal=False), "sha256")


PERMUTED = [*joint_names()[3:6], *joint_names()[:3], *joint_names()[6:]]
WRONG = {
    "permuted joints": (("joints", "order"), PERMUTED, "joints.order"),
    "no limits": (("joints", "upper"), [1e9] * 12, "joints.upper [1000000000.0"),
    "wide limits": (("joints", "lower"), [-1e9] * 12, "joints.lower [-1000000000.0"),
    "another pose": (("joints", "default_pose"), [0.1, 0.9, -1.8] * 4, "joints.default_pose [0.1"),
    "torque": (("joints", "torque_limit"), 1e9, "joints.torque_limit 1000000000.0 33.5"),
    "commands": (("rates", "pd_hz"), 50, "rates.pd_hz 50 400"),
    "ticks": (("rates", "policy_hz"), 50, "rates.policy_hz 50 25"),
    "gains": (("gains", "kp"), 80.0, "gains.kp 80.0 40.0"),
    "wild gains": (("gains", "kd"), 1e9, "gains.kd 1000000000.0 50"),
    "unit": (("gains", "unit"), "N·m/°", "gains.unit N·m/°"),
    "hold": (("hold",), 3, "hold 3 1"),
    "field's place": (("inputs", "state", "fields", 1, "offset"), 8, "inputs.state.fields.1.offset 8"),
    "length": (("inputs", "state", "shape"), [84], "inputs.state.shape.0 84 93"),
    "camera": (("inputs", "depth", "camera", "far"), 5.0, "inputs.depth.camera.far 5.0"),
    "camera's place": (("inputs", "depth", "camera", "offset"), 0.5, "inputs.depth.camera.offset 0.5 0.2309"),
    "encoding": (("inputs", "depth", "encoding"), "d", "inputs.depth.encoding"),
    "no inputs": (("inputs",), {}, "inputs {} 1"),
    "scale": (("action", "scale"), [3.0, 3.0, 3.0], "action.scale.0 3.0"),
    "latency": (("latency", "trained_with"), [0.0, 0.04], "latency.trained_with.1 0.04"),
    "task": (("training", "task"), "wide", "training.task wide"),
    "no key": (("config", "env", "weather"), "fine", "weather"),
    "no number": (("config", "env", "kp"), "much", "env.kp much"),
    "another configuration": (("config", "seed"), 4, "config_hash"),
    "unknown": (("safety",), "off", "safety"),
    "unknown inside": (("joints", "offset"), 1.0, "joints offset"),
}


@pytest.mark.parametrize(("path", "value", "said"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_is_named(path, value, said, policy, manifest):
    assert says(refused(policy, changed(manifest, path, value)), said)


def test_everything_that_is_written_has_to_be_there(policy, manifest):
    for path in paths(manifest):
        if isinstance(path[-1], str) and not {"config", "versions"} & set(path[:-1]) and path[0] not in ("sha256",):
            tree = copy.deepcopy(manifest)
            del reduce(lambda node, key: node[key], path[:-1], tree)[path[-1]]
            if path in (("inputs", "state"), ("inputs", "depth")):
                continue  # the ONNX file tells
            assert refused(policy, tree), path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"torque_limit": 33.5', '"torque_limit": Infinity', "Infinity"),
        ('"torque_limit": 33.5', '"torque_limit": 1e999', "1e999"),
        ('"kd": 0.6', '"kd": NaN', "NaN"),
        ('"torque_limit": 33.5', '"torque_limit": 33.5, "torque_limit": 1', "torque_limit twice"),
        ('"config": {', '"config": ' + "[" * 100_000, "nested"),
        ('"config": {', '"config": \udcff{', "decode"),
    ],
)
def test_what_is_no_json_of_ours(old, new, said, policy, manifest):
    text = (policy / folder.MANIFEST).read_text()
    assert old in text
    (policy / folder.MANIFEST).write_bytes(text.replace(old, new).encode(errors="surrogateescape"))
    with refusal(f"{policy / folder.MANIFEST} {said}"):
        folder.read(policy)


def test_words_for_people_may_differ(policy, manifest):
    other = changed(manifest, ("inputs", "depth", "order"), "as before")
    flat.write_manifest(policy, {key: value for key, value in other.items() if key != "sha256"})
    assert folder.read(policy).joints == joint_names()


def test_a_file_beside_the_network_is_checked_where_there_is_one(policy, manifest):
    described = manifest | {"files": manifest["files"] | {folder.PARAMETERS: {"sha256": "0" * 64}}}
    flat.write_manifest(policy, {key: value for key, value in described.items() if key != "sha256"})
    assert folder.read(policy).policy == "made up"
    (policy / folder.PARAMETERS).write_bytes(b"other parameters")
    assert says(refused(policy, described), f"{policy / folder.PARAMETERS} {folder.MANIFEST}")
    (policy / folder.PARAMETERS).unlink()


def test_the_description_is_of_what_the_environment_gives():
    fields = description.describe(Config(), ("state",), 1)["inputs"]["state"]["fields"]
    given = observation.first_history(Config().env.observation, A1)
    assert [(field["name"], field["frames"], field["size"]) for field in fields] == [
        (name, *past.shape) for name, past in given.items()
    ]
    assert (description.CODE_OFFSET, description.CODE_SCALE) == (encoding.OFFSET, encoding.SCALE)
