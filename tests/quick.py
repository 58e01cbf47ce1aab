"""How tests compile whose subject is not what the compiler makes of a program: in half the time, without optimisation.

Two of the three means are JAX's settings and XLA's flags. The third concerns the two ways in which XLA's CPU compiler
can write loops, of which the older compiles sooner: programs are compiled deep inside of what is tested, and no setting
of JAX reaches there, so its own function that collects the compiler's options is wrapped.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import Any

import jax
from jax._src import compiler

# Options of `jax.jit` for single programs: one beside the subject of a test whose programs are optimised; one that runs
# for longer than it takes to optimise it.
QUICKLY = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
OPTIMISED = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}

_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


class Compilation:
    """Compiles quickly, or as users do, in this process and in those that it starts."""

    def __init__(self) -> None:
        self._asked: bool | None = None
        self._quickly, self._flags = False, os.environ.get("XLA_FLAGS", "")
        compiler.get_compile_options = self._with_options(compiler.get_compile_options)

    def choose(self, quickly: bool) -> None:
        """Says how from now on."""
        more = " ".join(f"--{name}={str(value).lower()}" for name, value in _OPTIONS.items())
        known = self._known  # asked before anything is set: by then this process has read its flags
        if self._asked != quickly:
            jax.clear_caches()  # of programs that were compiled the other way
        self._asked, self._quickly = quickly, quickly and known
        jax.config.update("jax_disable_most_optimizations", quickly)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(quickly))
        os.environ["XLA_FLAGS"] = f"{self._flags} {more}".strip() if self._quickly else self._flags

    def _with_options(self, collect: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(collect)
        def collect_more(*args: Any, **kwargs: Any) -> Any:
            options = collect(*args, **kwargs)
            if self._quickly:
                options.env_option_overrides = [*options.env_option_overrides, *_OPTIONS.items()]
            return options

        return collect_more

    @functools.cached_property
    def _known(self) -> bool:
        """Whether this XLA has the options; one that has not refuses to compile, and as flags even to start."""
        try:
            jax.jit(lambda: 0.0, compiler_options=_OPTIONS)()
        except Exception:  # of its own kind in every version
            return False
        return True
