"""The policies that come with the package: whole, of today's robot and configuration, and they walk in C MuJoCo."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from loco_mjx import policies
from loco_mjx.cli.main import main
from loco_mjx.deploy import export, folder, trained
from loco_mjx.deploy.session import Session
from tests.deploy import made

NAMES = policies.names()
COUNT = 20


def test_there_is_one_that_sees():
    assert "mountain" in NAMES
    assert {folder.read(policies.SHIPPED / name).policy for name in NAMES} >= {"loco-transformer"}


@pytest.mark.parametrize("name", NAMES)
def test_its_onnx_is_its_parameters(name):
    where = policies.SHIPPED / name
    policy, manifest = trained.load(where), folder.read(where)
    views = made.observations(COUNT)
    inputs = list(export.inputs(policy))
    expected = np.asarray(jax.jit(export.target_function(policy))(*(views[n] for n in inputs)))
    session = Session(manifest, where)
    found = np.array([session({n: views[n][i] for n in inputs}) for i in range(COUNT)])
    np.testing.assert_allclose(found, expected, atol=1e-4)
    figures = manifest.raw["training"]["evaluation"]
    assert figures["task"] == manifest.raw["training"]["task"]
    assert figures["num_episodes"] >= 64


@pytest.mark.parametrize("name", NAMES)
def test_it_walks_in_c_mujoco(name, capsys):
    task = folder.read(policies.SHIPPED / name).raw["training"]["task"]
    assert main(["deploy", name, "--task", task, "--seconds", "3"]) == 0
    said = capsys.readouterr().out
    distance = float(said.split("distance from start to end:")[1].split()[0])
    assert distance > 0.5
