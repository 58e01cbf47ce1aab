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
        assert "its hash is another" in refused(policy, other, seal=False)
    assert "'sha256' is a required property" in refused(
        policy, {key: value for key, value in manifest.items() if key != "sha256"}, seal=False
    )


PERMUTED = [*joint_names()[3:6], *joint_names()[:3], *joint_names()[6:]]
WRONG = {
    "permuted joints": (("joints", "order"), PERMUTED, "joints.order is"),
    "no limits": (("joints", "upper"), [1e9] * 12, "joints.upper is [1000000000.0"),
    "wide limits": (("joints", "lower"), [-1e9] * 12, "joints.lower is [-1000000000.0"),
    "another pose": (("joints", "default_pose"), [0.1, 0.9, -1.8] * 4, "joints.default_pose is [0.1"),
    "torque": (("joints", "torque_limit"), 1e9, "joints.torque_limit is 1000000000.0; accepted: 33.5"),
    "commands": (("rates", "pd_hz"), 50, "rates.pd_hz is 50; accepted: 400"),
    "ticks": (("rates", "policy_hz"), 50, "rates.policy_hz is 50; accepted: 25"),
    "gains": (("gains", "kp"), 80.0, "gains.kp is 80.0; accepted, for its configuration: 40.0"),
    "wild gains": (("gains", "kd"), 1e9, "gains.kd is 1000000000.0; accepted: maximum 50"),
    "unit": (("gains", "unit"), "N·m/°", "gains.unit is"),
    "hold": (("hold",), 3, "hold is 3; accepted: 1 or the configuration's 1"),
    "field's place": (("inputs", "state", "fields", 1, "offset"), 8, "inputs.state.fields.1.offset is 8; accepted"),
    "length": (("inputs", "state", "shape"), [84], "inputs.state.shape.0 is 84; accepted, for its configuration: 93"),
    "camera": (("inputs", "depth", "camera", "far"), 5.0, "inputs.depth.camera.far is 5.0; accepted"),
    "camera's place": (("inputs", "depth", "camera", "offset"), 0.5, "camera.offset is 0.5; accepted: 0.2309"),
    "encoding": (("inputs", "depth", "encoding"), "d", "inputs.depth.encoding is"),
    "no inputs": (("inputs",), {}, "inputs is {}; accepted: minProperties 1"),
    "scale": (("action", "scale"), [3.0, 3.0, 3.0], "action.scale.0 is 3.0"),
    "latency": (("latency", "trained_with"), [0.0, 0.04], "latency.trained_with.1 is 0.04"),
    "task": (("training", "task"), "wide", "training.task is"),
    "no key": (("config", "env", "weather"), "fine", "no keys ['weather']"),
    "no number": (("config", "env", "kp"), "much", "env.kp is 'much'"),
    "another configuration": (("config", "seed"), 4, "config_hash"),
    "unknown": (("safety",), "off", "'safety' was unexpected"),
    "unknown inside": (("joints", "offset"), 1.0, "joints: Additional properties are not allowed"),
}


@pytest.mark.parametrize(("path", "value", "said"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_is_named(path, value, said, policy, manifest):
    assert said in refused(policy, changed(manifest, path, value))


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
        ('"torque_limit": 33.5', '"torque_limit": Infinity', "Infinity is no number"),
        ('"torque_limit": 33.5', '"torque_limit": 1e999', "1e999 is too large"),
        ('"kd": 0.6', '"kd": NaN', "NaN is no number"),
        ('"torque_limit": 33.5', '"torque_limit": 33.5, "torque_limit": 1', "'torque_limit' is there twice"),
        ('"config": {', '"config": ' + "[" * 100_000, "nested too deeply"),
        ('"config": {', '"config": \udcff{', "cannot be read"),
    ],
)
def test_what_is_no_json_of_ours(old, new, said, policy, manifest):
    text = (policy / folder.MANIFEST).read_text()
    assert old in text
    (policy / folder.MANIFEST).write_bytes(text.replace(old, new).encode(errors="surrogateescape"))
    with pytest.raises(UserError, match=said):
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
    assert "policy.npz is not the file" in refused(policy, described)
    (policy / folder.PARAMETERS).unlink()


def test_the_description_is_of_what_the_environment_gives():
    fields = description.describe(Config(), ("state",), 1)["inputs"]["state"]["fields"]
    given = observation.first_history(Config().env.observation, A1)
    assert [(field["name"], field["frames"], field["size"]) for field in fields] == [
        (name, *past.shape) for name, past in given.items()
    ]
    assert (description.CODE_OFFSET, description.CODE_SCALE) == (encoding.OFFSET, encoding.SCALE)
