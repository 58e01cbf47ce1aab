"""The `loco-mjx` command: finds the verb, hands over the rest, turns mistakes into one line and an exit code.

A new verb is one file ``loco_mjx/cli/<verb>.py`` with a function ``main(args)`` and one line in ``VERBS``.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import sys
from collections.abc import Sequence

from loco_mjx import imports
from loco_mjx.cli import terminal
from loco_mjx.cli import words as command_line
from loco_mjx.errors import RunError, UnknownNameError, UserError, is_full
from loco_mjx.run.signals import Interrupt

VERBS: dict[str, str] = {
    "train": "train a policy on a task; the same command again resumes",
    "evaluate": "run a trained policy for episodes on any task and report the metrics",
    "sweep": "train and evaluate every combination of tasks, policies and seeds; again: goes on",
    "table": "write the paper's tables from the evaluations of a directory of runs",
    "curves": "draw training and evaluation curves over seeds from a directory of runs",
    "bench": "measure the speed of depth, physics, the environment or training",
    "export": "write a policy as a folder that runs without JAX",
    "simcheck": "run an exported policy in C MuJoCo and in MJX and compare",
    "deploy": "run an exported policy on a robot: C MuJoCo's or a real one",
    "play": "watch a policy: a video, a figure, or a live viewer in the browser",
    "scene": "write a generated scene as MJCF and as a picture",
}
# Packages that an installation may lack, by the extra that brings them.
_TRAIN = ("jax", "jaxlib", "flax", "optax", "mujoco", "orbax", "rich", "tensorboardX", "matplotlib")
EXTRAS: dict[str, str] = dict.fromkeys((*_TRAIN, "imageio_ffmpeg"), "train")
EXTRAS |= {"onnxruntime": "deploy", "jsonschema": "deploy", "onnx": "export", "pyrealsense2": "a1", "trimesh": "play"}
INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: the words after `loco-mjx`; None takes them from the command line.

    Returns:
        The exit code: 0; 2 for a mistake in what was asked; 1 for a full disk and the like; 130 if stopped by Ctrl-C.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    terminal.print_anything()
    with Interrupt() as interrupt:
        code = _guarded(words, interrupt)
    try:
        sys.stdout.flush()
    except OSError:  # nobody reads it any more; Python would try again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if argv is None and code > 128:  # a compiler that was interrupted may not survive Python's own way to end
        os._exit(code)
    return code


def _guarded(words: Sequence[str], interrupt: Interrupt) -> int:
    """Runs one command; what goes wrong becomes a line and an exit code."""
    try:
        terminal.check_text(words)
        return _run(words)
    except SystemExit as stop:
        if not isinstance(stop.code, int) or stop.code == 0:  # the help was printed
            raise
        return stop.code  # tyro has said what it does not accept
    except UserError as error:
        _say(" ".join(str(error).split()))
        return error.code
    except BrokenPipeError:  # whoever read our output has gone, e.g. `| head`
        return INTERRUPTED
    except OSError as error:  # errors of the system that any command may meet; others are bugs and keep their traceback
        if not is_full(error) and error.errno not in (errno.EACCES, errno.EROFS):
            raise
        _say(str(error))
        return RunError.code if is_full(error) else UserError.code
    except (KeyboardInterrupt, Exception) as error:
        if isinstance(error, Exception) and not interrupt.came:
            raise
        _say("stopped")  # a library may have turned the interrupt into an error of its own
        return INTERRUPTED


def _say(text: str) -> None:
    with contextlib.suppress(OSError):  # the terminal may have gone, or what it is written to be full
        print(f"loco-mjx: {text}", file=sys.stderr)


def _run(words: Sequence[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(_usage())
        return 0
    if words[0] == "--version":
        from loco_mjx import __version__

        print(__version__)
        return 0
    verb, rest = words[0], words[1:]
    if verb not in VERBS:
        raise UnknownNameError("command", verb, VERBS)
    modules = command_line.imports(rest)
    if modules:
        from loco_mjx.cli.scene import choose_gl

        choose_gl()  # before a module imports MuJoCo
        imports.load(modules)
    try:
        code = importlib.import_module(f"loco_mjx.cli.{verb}").main(list(rest))
    except OSError as error:
        if error.errno not in (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR):
            raise
        raise UserError(
            f"{error.strerror}: {error.filename!s:.200}; accepted: a path that exists or can be made"
        ) from error
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise UserError(f"{verb} needs {package}: pip install 'loco-mjx[{EXTRAS[package]}]'") from error
    return code or 0


def _usage() -> str:
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {verb:<{width}}  {summary}" for verb, summary in VERBS.items())
    return f"usage: loco-mjx COMMAND [options]\n\n{verbs}\n\nloco-mjx COMMAND --help lists a command's options."


if __name__ == "__main__":
    sys.exit(main())
