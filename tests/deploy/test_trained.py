"""A policy read back from an exported folder is the policy that was exported, and shipped ones go by name."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from loco_mjx import policies
from loco_mjx.deploy import description, export, folder, trained
from tests.deploy import made
from tests.refusals import refusal

NAME = "loco-transformer"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "stablehlo", lambda policy: b"")
        where = tmp_path_factory.mktemp("exported") / "policy"
        export.write(made.policy(NAME, critic="privileged"), where)
    return where


def _sign(where: Path, name: str) -> None:
    """Has the manifest speak of a file as it is now."""
    manifest = json.loads((where / folder.MANIFEST).read_text())
    manifest["files"][name]["sha256"] = folder.digest(where / name)
    (where / folder.MANIFEST).write_text(json.dumps(manifest | {"sha256": description.sealed(manifest)}))


def _copy(exported: Path, to: Path) -> Path:
    to.mkdir()
    for entry in exported.iterdir():
        (to / entry.name).write_bytes(entry.read_bytes())
    return to


def test_what_was_exported_comes_back(exported):
    policy, back = made.policy(NAME, critic="privileged"), trained.load(exported)
    assert back.config == policy.config
    assert back.samples == policy.samples
    jax.tree.map(np.testing.assert_array_equal, back.params, policy.params)
    views = [made.observations(20)[name] for name in export.inputs(policy)]
    expected, found = (np.asarray(jax.jit(export.target_function(which))(*views)) for which in (policy, back))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_critic_may_be_left_out_and_nothing_else(exported, tmp_path):
    where = _copy(exported, tmp_path / "policy")
    arrays = dict(np.load(exported / folder.PARAMETERS))
    kept = {name: array for name, array in arrays.items() if not name.startswith(trained.CRITIC_ONLY)}
    assert len(kept) < len(arrays)
    np.savez(where / folder.PARAMETERS, **kept)
    with refusal(f"{where / folder.PARAMETERS} {folder.MANIFEST}"):
        trained.load(where)
    _sign(where, folder.PARAMETERS)
    views = [made.observations(20)[name] for name in export.inputs(trained.load(exported))]
    both = (trained.load(at) for at in (exported, where))
    expected, found = (np.asarray(jax.jit(export.target_function(policy))(*views)) for policy in both)
    np.testing.assert_array_equal(found, expected)
    kept.pop("state_token/bias")
    np.savez(where / folder.PARAMETERS, **kept)
    _sign(where, folder.PARAMETERS)
    with refusal("state_token/bias (32,)"):
        trained.load(where)


def test_the_users_own_folder_comes_before_a_shipped_name(exported, tmp_path, monkeypatch):
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    _copy(exported, shipped / "walker")
    monkeypatch.setattr(policies, "SHIPPED", shipped)
    monkeypatch.chdir(tmp_path)
    assert policies.names() == ("walker",)
    assert policies.find(Path("walker")) == shipped / "walker"
    assert policies.find(Path("runner")) == Path("runner")
    Path("walker").mkdir()
    assert policies.find(Path("walker")) == Path("walker")
