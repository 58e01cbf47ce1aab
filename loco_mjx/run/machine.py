"""Sets this machine up for JAX: cores as devices, and the persistent compilation cache."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

MIN_COMPILE_SECONDS = 0.5  # programs that compile faster are not worth keeping


def cores() -> int:
    """CPU cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def shards(*sizes: int, limit: int | None = None, processes: int = 1) -> int:
    """The most devices of one of several processes, up to `limit` (default: the cores), over which all sizes divide."""
    common = math.gcd(*sizes) // processes or 1
    most = cores() if limit is None else limit
    return max(n for n in range(1, max(most, 1) + 1) if common % n == 0)


def cache_directory() -> Path:
    """Where compiled programs are kept: $XDG_CACHE_HOME/loco-mjx/xla, or the same under ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "loco-mjx" / "xla"


def set_up(cpu_devices: int | None = None) -> None:
    """Configures JAX as every command does: to be called before anything runs on a device, harmless afterwards.

    Compiled programs are kept in :func:`cache_directory`, unless JAX has been told of another place.

    Args:
        cpu_devices: devices that the CPU counts as where there is no accelerator; None: one per core.
    """
    import jax

    # A running backend keeps the number it started with.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", cpu_devices or cores())
    if jax.config.jax_compilation_cache_dir is None and _writable(cache_directory()):  # type: ignore[attr-defined]
        jax.config.update("jax_compilation_cache_dir", str(cache_directory()))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", MIN_COMPILE_SECONDS)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def process_age() -> float | None:
    """Seconds since this process started; None where the system does not tell."""
    try:
        ticks = float(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        uptime = float(Path("/proc/uptime").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
    return uptime - ticks / os.sysconf("SC_CLK_TCK")


def on_cpu() -> bool:
    """Whether JAX runs on the CPU."""
    import jax

    return jax.default_backend() == "cpu"
