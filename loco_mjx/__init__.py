"""loco-mjx: vision-guided legged locomotion, from scene to policy in one JAX program."""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
__all__ = ["__version__", "make_env"]


def __getattr__(name: str) -> Any:
    # JAX and MuJoCo load when an environment is first asked for, not when the package's version is.
    if name == "make_env":
        from loco_mjx.env import make_env

        return make_env
    raise AttributeError(f"module 'loco_mjx' has no attribute '{name}'")
