"""Physics and depth are compared with C MuJoCo as users compile them; everything else is compiled quickly."""

import os

import jax
import jax.numpy as jp
import numpy as np
import pytest
from jax._src import compiler

from loco_mjx.scene.tasks import TASKS
from tests import conftest, quick
from tests.oracle import test_depth_c_mujoco, test_physics_c_mujoco


@pytest.fixture
def compilation(monkeypatch):
    for name in ("XLA_FLAGS", "JAX_DISABLE_MOST_OPTIMIZATIONS"):  # put back afterwards
        monkeypatch.setenv(name, os.environ.get(name, ""))
    yield conftest._COMPILATION
    conftest._COMPILATION.choose(quickly=True)  # as this file is


def test_what_is_not_quick_is_compiled_as_by_users_and_quick_programs_compute_the_same(compilation):
    compilation.choose(quickly=False)
    assert not compiler.get_compile_options(1, 1).env_option_overrides
    assert "fusion_emitters" not in os.environ["XLA_FLAGS"] and os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] == "0"
    compilation.choose(quickly=True)
    assert dict(compiler.get_compile_options(1, 1).env_option_overrides) == quick._OPTIONS
    assert "--xla_cpu_use_fusion_emitters=false" in os.environ["XLA_FLAGS"]
    np.testing.assert_allclose(jp.cumsum(jp.arange(4.0) ** 2), [0, 1, 5, 14])


@pytest.mark.optimized
def test_the_marker_has_programs_compiled_as_by_users():
    assert not compiler.get_compile_options(1, 1).env_option_overrides
    assert os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] == "0"


def test_without_it_they_are_compiled_quickly():
    assert os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] == "1"


def test_physics_and_depth_are_compared_with_c_mujoco_as_users_compile_them():
    assert test_physics_c_mujoco.pytestmark.name == "optimized"
    marks = {task.values[0]: {mark.name for mark in task.marks} for task in test_depth_c_mujoco.EVERY_TASK}
    assert set(marks) == set(TASKS)
    assert {task for task, names in marks.items() if names} == {"thin-sphere", "indoor", "mountain", "forest"}


def test_a_program_is_compiled_again_when_it_is_to_be_compiled_otherwise(compilation):
    traced = []
    program = jax.jit(lambda x: traced.append(None) or x + 1)
    for quickly, times in ((True, 1), (True, 1), (False, 2), (True, 3)):
        compilation.choose(quickly)
        program(1.0)
        assert len(traced) == times
