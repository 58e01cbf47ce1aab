"""What a script gets from `import loco_mjx`: names, types, quiet, the set-up of the command line, and no Brax."""

import subprocess
import sys
from importlib import resources

import loco_mjx

SCRIPT = """
import sys, loco_mjx
print(*dir(loco_mjx))
print(*{"jax", "mujoco"} & set(sys.modules))
loco_mjx.set_up()
env = loco_mjx.wrap_for_brax(loco_mjx.make_env("thin"))
import jax
from loco_mjx.run import machine
print(len(jax.devices("cpu")) == machine.cores(), jax.config.jax_compilation_cache_dir)
import loco_mjx.evaluation.episodes, loco_mjx.ppo.trainer, loco_mjx.run.start
import loco_mjx.simcheck.run, loco_mjx.show.rollout
print("brax" in sys.modules)
"""


def test_a_script_finds_names_devices_and_the_cache_and_nothing_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    names = " ".join(sorted(loco_mjx.__all__))
    cache = tmp_path / "loco-mjx" / "xla"
    assert done.stdout.splitlines() == [names, "", f"True {cache}", "False"]
    assert cache.is_dir()


def test_every_public_name_is_there():
    for name in loco_mjx.__all__:
        assert getattr(loco_mjx, name)
    assert (resources.files(loco_mjx) / "py.typed").is_file()
