"""A policy over the whole-body controller: its folder, and its run on C MuJoCo's A1."""

import dataclasses
import time

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import NetworkConfig, preset
from loco_mjx.deploy import description, export, folder, schema, trained
from loco_mjx.deploy.guided import Guided
from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.runner import Runner
from loco_mjx.deploy.safety import Cause
from loco_mjx.deploy.session import Session
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import normalizer
from loco_mjx.run.policy import TrainedPolicy, observation_shapes
from loco_mjx.run.settings import complete
from tests.deploy import flat
from tests.known_robots import A1
from tests.refusals import refusal

pytest.importorskip("quadprog")  # the extra `mpc`

SIZES = NetworkConfig(token_dim=16, mlp_dim=16, hidden=(16, 16))


def config(policy="loco-transformer", side=8):
    """Of a policy with a camera of so many pixels."""
    whole = dataclasses.replace(preset("fast", controller="mpc"), policy=policy, network=SIZES)
    seen = dataclasses.replace(whole.env.observation.depth, height=side, width=side)
    observed = dataclasses.replace(whole.env.observation, depth=seen)
    return complete(dataclasses.replace(whole, env=dataclasses.replace(whole.env, observation=observed)))


def raw():
    """A manifest without files."""
    training = {"task": "thin", "samples": 8192, "evaluation": None}
    about = description.describe(config(), ("state", "depth"), 1)
    return about | {"training": training, "versions": {"loco-mjx": "0"}, "files": {}}


def guided(decide, seconds=2.0, **how):
    """The run of a policy."""
    manifest = folder.build(raw())
    robot = MujocoRobot(flat.model(), manifest.camera, policy_hz=manifest.policy_hz)
    run = Guided(manifest, decide, A1, robot, clock=flat.clock, patience=5.0, **how)
    return run, run.run(seconds)


def test_it_decides_20_times_a_second_and_walks():
    seen = []

    def decide(obs):
        seen.append(obs)
        return np.array([0.3, 0.2])

    run, record = guided(decide)
    assert record.cause is None and run.unsolved == 0
    assert len(seen) == 1 + 40  # one before the robot is commanded
    assert {name: part.shape for name, part in seen[-1].items()} == {"state": (6,), "depth": (8, 8, 4)}
    assert record.distance == pytest.approx(0.55, abs=0.12)
    velocity, attitude = np.split(seen[-1]["state"], 2)
    turned = record.rows[399]["quat"]
    assert attitude[2] == pytest.approx(2 * np.arctan2(turned[3], turned[0]), abs=0.02)
    ahead = velocity[:2] @ [np.cos(attitude[2]), np.sin(attitude[2])]
    assert ahead == pytest.approx(0.3, abs=0.08) and abs(velocity[2]) < 0.1
    assert not np.array_equal(seen[-1]["depth"][..., 0], seen[-1]["depth"][..., 1])


def test_a_robot_that_does_not_wait_walks_on_while_its_policy_thinks():
    """Its ticks are on time; what is decided counts from the tick after it is there."""
    begun = []

    def slowly(obs):
        begun.append(0.1 + 0.01 * len(begun))
        time.sleep(0.02)  # several ticks
        return np.array([begun[-1], 0.0])

    run, record = guided(slowly, seconds=1.0, waits=False)
    assert record.cause is None and run.unsolved == 0
    wanted = np.array([row["wanted"][0] for row in record.rows[:200]])
    np.testing.assert_allclose(np.diff([row["time"] for row in record.rows[:200]]), 0.005, atol=1e-6)
    changed = np.flatnonzero(np.diff(wanted)) + 1
    assert 2 <= changed.size <= 20
    assert set(wanted[changed]) <= set(begun) and wanted[0] == 0


@pytest.mark.parametrize("waits", [True, False])
def test_a_policy_that_breaks_stops_the_robot_whether_it_waits_or_not(waits):
    made = iter([0.0] * 10)
    record = guided(lambda obs: np.array([0.3, next(made)]), waits=waits)[1]
    assert record.cause == Cause.POLICY


def test_a_policy_that_fails_sits_the_robot_down():
    made = iter([0.0] * 10)
    record = guided(lambda obs: np.array([0.3, next(made, np.nan)]))[1]
    assert record.cause == Cause.NONFINITE_ACTION


def test_a_policy_of_another_size_is_refused_before_the_robot_moves():
    with refusal("policy output 2"):
        guided(lambda obs: np.zeros(12))


def test_one_controllers_policy_is_refused_by_the_other():
    theirs, ours = folder.build(raw()), flat.manifest()
    robot = MujocoRobot(flat.model(), None)
    with refusal("commands mpc pd"):
        Runner(theirs, lambda obs: np.zeros(2), robot)
    with refusal("targets pd mpc"):
        Guided(ours, lambda obs: np.zeros(12), A1, robot)


def sealed(changes):
    """A manifest with changes, which says so of itself."""
    changed = raw() | {"files": {folder.ONNX: {"sha256": "0" * 64}}} | changes
    return changed | {"sha256": description.sealed(changed)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"controller": "pd"}, "outputs"),
        ({"controller": "pid"}, "controller pid pd mpc"),
        ({"rates": {"policy_hz": 25, "pd_hz": 400}}, "rates.policy_hz 25 20"),
        ({"action": {"scale": [0.5, 0.3], "included_in_onnx": True}}, "action.scale 0.5 0.4"),
    ],
)
def test_a_manifest_that_is_not_its_controllers_is_refused(changes, words):
    schema.check(sealed({}))
    with refusal(words):
        schema.check(sealed(changes))


def test_an_exported_policy_gives_the_same_commands(tmp_path):
    whole = config("visual-cnn", side=64)
    networks = make_networks(whole.policy, whole.network, whole.env.action_size)
    obs = {name: jp.zeros(shape) for name, shape in observation_shapes(whole).items()}
    rng = np.random.default_rng(2)
    first = jax.jit(networks.init)(jax.random.key(1), obs)
    params = jax.tree.map(lambda x: np.asarray(x + 0.1 * rng.normal(size=x.shape), np.float32), first)
    made = TrainedPolicy(whole, networks, params, normalizer.of(jp.full(6, 0.1), jp.full(6, 0.5)), samples=8192)
    export.write(made, tmp_path, lean=True)
    manifest = folder.read(tmp_path)
    given = {name: rng.uniform(-1, 1, shape).astype(np.float32) for name, shape in manifest.shapes.items()}
    commands = Session(manifest, tmp_path)(given)
    np.testing.assert_allclose(commands, jax.jit(export.target_function(made))(*given.values()), atol=1e-5)
    assert commands.shape == (2,) and (np.abs(commands) <= [0.4, 0.3]).all() and np.abs(commands).max() > 1e-3
    assert trained.load(tmp_path).config.env.controller == "mpc"
