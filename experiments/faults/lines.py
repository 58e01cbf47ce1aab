"""Command lines that cannot be: each has to be refused with a reason, nothing written and nothing computed."""

from __future__ import annotations

import contextlib
import importlib
import io
import random
import shlex
import shutil
import signal
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from experiments.faults import made, places
from loco_mjx.cli.main import main as command

# What each command does once everything that it was asked for is accepted.
WORK = (
    *("loco_mjx.run.start.build", "loco_mjx.bench.training.bench_env", "loco_mjx.cli.play._film"),
    *("loco_mjx.show.web.serve", "loco_mjx.evaluation.report.Evaluator.run", "loco_mjx.simcheck.run.start"),
    *("loco_mjx.deploy.runner.Runner.run", "loco_mjx.cli.scene._write", "loco_mjx.deploy.export.write"),
)
LIMIT = 120  # s, after which a command counts as hanging
KINDS = ("refused", "tracebacks", "accepted", "hangs", "wrote", "unclear")


class Hangs(BaseException):
    """Raised when a command takes too long."""


def lines(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Gives the command lines that cannot be, and counts what came of them by kind and by command."""
    numbers, found, problems = random.Random(seed), Counter(dict.fromkeys(KINDS, 0)), []
    verbs: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(dir=folder) as name, working():
        place = Path(name)
        for number in range(count):
            words = made.line(place, numbers)
            kind, said = given(words, place)
            found[kind] += 1
            verbs[words[0] if words[0] in made.VERBS else "no command"] += 1
            if kind != "refused":
                shown = shlex.join(word if len(word) < 100 else word[:100] + "…" for word in words)
                problems.append(f"line {number}: {shown!a}: {kind}: {said[-600:]}")
            for entry in place.iterdir():
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    return {"injected": count, **found, "of": dict(sorted(verbs.items())), "problems": problems}


def given(words: list[str], place: Path) -> tuple[str, str]:
    """What comes of a command line, in a folder of its own: its kind, and what it wrote on stderr."""
    before, errors = places.content(place), io.StringIO()
    signal.alarm(LIMIT)
    try:
        with contextlib.chdir(place), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            code = command(words)
    except SystemExit as stop:
        code = 0 if stop.code is None else stop.code
    except Hangs:
        return "hangs", errors.getvalue()
    except BaseException:
        return "tracebacks", traceback.format_exc()
    finally:
        signal.alarm(0)
    said = errors.getvalue()
    if code == 0:
        return "accepted", said
    if places.content(place) != before:
        return "wrote", said
    # One line, after those that tell of checkpoints that cannot be used; or what tyro says of an option, in a box.
    lines = said.splitlines()
    boxed = "--help" in said and "Traceback" not in said
    told = said.endswith("\n") and (boxed or all(line.startswith("loco-mjx: ") for line in lines))
    return ("refused" if told and code == 2 else "unclear"), f"exit code {code}: {said}"


@contextlib.contextmanager
def working() -> Iterator[None]:
    """Commands that would begin their work end with exit code 0 instead; those that hang are interrupted."""
    before = []
    for path in WORK:
        owner, name = _owner(path)
        before.append((owner, name, getattr(owner, name)))
        setattr(owner, name, _begin)
    alarm = signal.signal(signal.SIGALRM, _hang)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, alarm)
        for owner, name, value in before:
            setattr(owner, name, value)


def _begin(*_: Any, **__: Any) -> None:
    raise SystemExit(0)


def _hang(number: int, frame: FrameType | None) -> None:
    raise Hangs


def _owner(path: str) -> tuple[Any, str]:
    """The module or class that holds what a path names, and its name there."""
    module, _, name = path.rpartition(".")
    if module.rpartition(".")[2][:1].isupper():
        owner, attribute = _owner(module)
        return getattr(owner, attribute), name
    return importlib.import_module(module), name
