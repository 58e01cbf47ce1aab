"""Arithmetic is tested as users' programs are compiled, everything else quickly; which one, a test's folder says."""

import os

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


def test_the_folders_where_arithmetic_is_tested_are_there():
    tests = conftest.__file__.rpartition("/")[0]
    assert all(os.path.isdir(os.path.join(tests, folder)) for folder in conftest._OPTIMIZED)
