"""What is compared with C MuJoCo is compiled as for users, everything else quickly; the marker `optimized` says it."""

import os
from pathlib import Path

import jax
import jax.numpy as jp
import numpy as np
import pytest
from jax._src import compiler

from tests import conftest, quick


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


def test_what_is_compared_with_c_mujoco_is_compiled_as_by_users():
    tests = Path(conftest.__file__).parent
    files = [file for folder in ("oracle", "physics", "depth") for file in (tests / folder).glob("test_*.py")]
    comparing = [file for file in files if "mujoco" in file.read_text()]
    assert {file.parent.name for file in comparing} >= {"oracle", "physics"}
    assert [file.name for file in comparing if "pytestmark = pytest.mark.optimized" not in file.read_text()] == []


def test_a_program_is_compiled_again_when_it_is_to_be_compiled_otherwise(compilation):
    traced = []
    program = jax.jit(lambda x: traced.append(None) or x + 1)
    for quickly, times in ((True, 1), (True, 1), (False, 2), (True, 3)):
        compilation.choose(quickly)
        program(1.0)
        assert len(traced) == times
