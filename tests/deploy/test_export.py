"""The exported function is the trained policy, for every policy; the folder says what it holds."""

import json
import os

import flax.linen as nn
import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import NetworkConfig
from loco_mjx.controllers import get_controller
from loco_mjx.deploy import converted, export, folder
from loco_mjx.deploy.session import Session
from loco_mjx.networks.outputs import heads
from loco_mjx.networks.registry import POLICIES, register_policy
from tests.compare.runs import edit, write_evaluation, write_run
from tests.deploy import made
from tests.known_robots import A1
from tests.refusals import refusal

COUNT, BATCH = 1000, 50
CASES = [(name, False, {}) for name, entry in POLICIES.items() if not entry.uses_privileged]
CASES += [("loco-transformer", False, {"critic": "privileged"})]
CASES += [("loco-transformer", True, {"tokens_per_side": 2, "layers": 1})]


@pytest.fixture(scope="module")
def views():
    return made.observations(COUNT)


@pytest.mark.parametrize(("name", "diagonal", "network"), CASES)
def test_parity(name, diagonal, network, views, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export, "stablehlo", lambda policy: b"")  # it takes a while and has a test of its own
    policy = made.policy(name, diagonal, **network)
    names = list(export.inputs(policy))
    in_jax = jax.jit(export.target_function(policy))
    batches = [[views[n][i : i + BATCH] for n in names] for i in range(0, COUNT, BATCH)]
    expected = np.concatenate([np.asarray(in_jax(*batch)) for batch in batches])
    export.write(policy, tmp_path)
    session = Session(folder.read(tmp_path), tmp_path)
    got = np.array([session({n: views[n][i] for n in names}) for i in range(COUNT)])
    # The test would say nothing of a policy that is all but constant: here 1e-4 rad is less than 1/100 of its range.
    assert np.all(np.ptp(expected, axis=0) > 0.1 * np.tile(policy.config.env.action.scale, 4))
    worst = np.max(np.abs(got - expected))
    with capsys.disabled():
        print(f"\n{name}{' diagonal' * diagonal}: {worst:.1e} rad")
    assert worst < 1e-4


@pytest.fixture
def own_policy():
    """One with what none of ours has: another convolution, normalisation, attention, gates."""

    @register_policy("gated")
    class Gated(nn.Module):
        config: NetworkConfig
        actions: int

        @nn.compact
        def __call__(self, obs):
            depth = obs["pixels/depth"]
            seen = nn.gelu(nn.Conv(8, (8, 8), (8, 8))(depth.reshape(-1, *depth.shape[-3:])))
            seen = nn.LayerNorm()(seen.reshape(*depth.shape[:-3], 64, 8))
            mixed = nn.SelfAttention(num_heads=2)(seen).mean(-2)
            body = nn.Dense(16)(obs["state"])
            features = jp.concatenate([nn.silu(body), body[..., :8] * nn.sigmoid(mixed)], axis=-1)
            return heads(self, (16,), features, lambda: features, obs)

    yield "gated"
    POLICIES.unregister("gated")


@pytest.mark.parametrize("diagonal", [False, True])
def test_parity_of_a_policy_of_the_user(own_policy, diagonal, views, tmp_path, monkeypatch):
    monkeypatch.setattr(export, "stablehlo", lambda policy: b"")
    policy = made.policy(own_policy, diagonal)
    export.write(policy, tmp_path)
    session = Session(folder.read(tmp_path), tmp_path)
    some = {name: views[name][:BATCH] for name in ("state", "depth")}
    expected = np.asarray(jax.jit(export.target_function(policy))(*some.values()))
    got = np.array([session({name: values[i] for name, values in some.items()}) for i in range(BATCH)])
    assert np.all(np.ptp(expected, axis=0) > 0.1 * np.tile(policy.config.env.action.scale, 4))
    assert np.max(np.abs(got - expected)) < 1e-4


def test_a_graph_that_differs_or_cannot_be_written_is_refused(own_policy, tmp_path, monkeypatch):
    policy = made.policy(own_policy)
    written = converted.written
    off = lambda name, f, *more: written(name, lambda *x: f(*x) + 1e-3, *more)  # noqa: E731
    monkeypatch.setattr(converted, "written", off)
    with refusal("gated 1.0e-03 0.0001"):
        export.write(policy, tmp_path / "policy")
    monkeypatch.undo()

    def odd(*arrays):
        return jax.pure_callback(lambda x: x, jax.ShapeDtypeStruct((1, 12), jp.float32), arrays[0][:, :12])

    with refusal("odd jax2onnx"):
        converted.convert("odd", odd, {"state": (93,)}, np.zeros(93), np.ones(93), get_controller("pd"))
    assert not (tmp_path / "policy").exists()


def test_the_figures_that_go_with_a_policy_are_of_its_mean(tmp_path):
    run = write_run(tmp_path)
    assert export.latest_evaluation(run) is None
    for age, (name, distance) in enumerate((("", 3.0), ("-older", 2.0), ("-stochastic", 4.0))):
        path = write_evaluation(run, "thin", name=name, distance=distance)
        os.utime(path, (1e9 - age, 1e9 - age))
    edit(path, deterministic=False)  # which makes it the newest
    assert export.latest_evaluation(run)["metrics"]["distance"]["mean"] == 3.0


def test_a_teacher_stays_in_the_simulator(tmp_path):
    with refusal("privileged ONNX"):
        export.write(made.policy("privileged"), tmp_path / "policy")
    assert not (tmp_path / "policy").exists()


def test_stablehlo_is_the_same_function(views, tmp_path):
    policy = made.policy("state-only")
    export.write(policy, tmp_path)
    called = jax.export.deserialize((tmp_path / folder.STABLEHLO).read_bytes()).call(views["state"][0])
    np.testing.assert_allclose(called, export.target_function(policy)(views["state"][0]), atol=1e-5)


def test_diagonal_legs_move_together(views):
    policy = made.policy("state-only", diagonal=True)
    targets = np.asarray(export.target_function(policy)(views["state"][0])) - np.array(A1.default_pose)
    front_right, front_left, rear_right, rear_left = targets.reshape(4, 3)
    np.testing.assert_array_equal(front_right, rear_left)
    np.testing.assert_array_equal(front_left, rear_right)
    assert np.abs(front_right - front_left).max() > 1e-3


def test_manifest_describes_the_observation(tmp_path):
    export.write(made.policy("hrl"), tmp_path)
    raw = json.loads((tmp_path / folder.MANIFEST).read_text())
    fields = raw["inputs"]["state"]["fields"]
    assert [(f["name"], f["offset"], f["size"], f["frames"]) for f in fields] == [
        ("displacement", 0, 3, 3),
        ("imu", 9, 4, 3),
        ("last_action", 21, 12, 3),
        ("angles", 57, 12, 3),
    ]
    assert raw["hold"] == 4 and raw["rates"] == {"policy_hz": 25, "pd_hz": 400}
    assert (raw["training"]["task"], raw["training"]["samples"]) == ("thin", 1234)
    camera = folder.read(tmp_path).camera
    assert (camera.vertical_fov, camera.horizontal_fov, camera.far, camera.offset) == (
        60.0,
        85.46,
        10.0,
        (0.2309, 0.0, 0.0),
    )


def test_raw_parameters_are_all_there(tmp_path):
    policy = made.policy("state-only")
    export.write(policy, tmp_path)
    kept = np.load(tmp_path / folder.PARAMETERS)
    layer = policy.params["params"]["policy_head"]["mean"]["output"]["kernel"]
    np.testing.assert_array_equal(kept["policy_head/mean/output/kernel"], layer)
    np.testing.assert_allclose(kept["normalizer/mean"], policy.normalizer.mean)
    assert len(kept.files) == len(jax.tree.leaves(policy.params)) + 2


def test_a_folder_with_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with refusal("thesis.tex --out"):
        export.export(tmp_path / "run", tmp_path)
