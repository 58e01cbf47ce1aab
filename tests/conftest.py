"""Shared by all tests: two CPU devices, as the command line makes them, and the persistent compilation cache."""

from __future__ import annotations

import gc
import os
import signal
from pathlib import Path

import jax
import pytest

from tests.quick import Compilation

jax.config.update("jax_num_cpu_devices", 2)
_CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "loco-mjx" / "xla"
jax.config.update("jax_compilation_cache_dir", str(_CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

# Tracing makes objects by the million, few of them garbage: searched for as often as is usual, it takes a twentieth of
# the time.
gc.set_threshold(50_000, 20, 20)

# Under nohup, or behind a shell's `&`, these are ignored, here and in every process that a test starts.
for _number, _handler in ((signal.SIGHUP, signal.SIG_DFL), (signal.SIGINT, signal.default_int_handler)):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _handler)

# Files whose tests take longest start first, so that no worker is left alone with one at the end.
_LONG = ("test_multihost.py", "test_web.py", "test_simcheck.py", "test_brax.py", "test_ray.py", "test_loco_env.py")
_LONG += ("test_physics_c_mujoco.py", "test_depth_c_mujoco.py", "test_learning.py", "test_train.py", "test_trainer.py")
_LONG += ("test_seeds.py", "test_multi_seed.py", "test_examples.py")


_COMPILATION = Compilation()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Chooses, before any fixture is made, how its programs are compiled, and those of the processes it starts.

    What is compared with C MuJoCo (the marker `optimized`) as users' are; the rest without optimisation, in half the
    time.
    """
    _COMPILATION.choose(quickly=item.get_closest_marker("optimized") is None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Orders the files; within one, tests stay as they are.

    Those whose programs are optimised come first: between them and the others, all that was compiled is forgotten.
    """

    def place(item: pytest.Item) -> tuple[bool, int]:
        module = item.getparent(pytest.Module)
        quickly = module is None or module.get_closest_marker("optimized") is None
        return quickly, _LONG.index(item.path.name) if item.path.name in _LONG else len(_LONG)

    items.sort(key=place)


@pytest.fixture
def key() -> jax.Array:
    """A key that a test may split as it likes."""
    return jax.random.PRNGKey(7)
