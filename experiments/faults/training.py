"""Faults of training: processes are killed, files are damaged, the disk fills up; then the same command goes on.

A run has to end like one that nothing happened to, bit for bit, or to refuse in one line and write nothing.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.faults import children, harms, places
from loco_mjx.cli import train
from loco_mjx.cli.main import main as command
from loco_mjx.config import Config
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.run import checkpoint, metrics_csv, start
from tests.run.tiny import tiny_trainer

ITERATIONS = 16  # of runs that are damaged halfway
LONG = 80  # of runs that are killed before
MORE = 3  # that those then go on for
WORDS = [
    *("train", "--policy", "state-only", "--preset", "paper", "--num-envs", "4", "--ppo.unroll", "8"),
    *("--ppo.minibatch", "16", "--ppo.epochs", "2", "--ppo.pool-size", "4", "--ppo.pool-refresh", "2"),
    *("--network.state-only-hidden", "8", "8", "--ppo.learning-rate-decay", "False", "--env.horizon", "10"),
    *("--evaluations", "0"),
]
PER_ITERATION = 32
KILLS_OF_A_RUN = 5
WHOLE = 0.2  # share of kills of a process that may still import
LIMIT = 120.0  # s, after which a process counts as hanging


def words(out: Path, iterations: int = ITERATIONS) -> list[str]:
    """The command that trains a run."""
    return [*WORDS, "--total-steps", str(PER_ITERATION * iterations), "--out", str(out)]


def _saving(out: Path) -> list[str]:
    """One that saves after every iteration, and is not to end by itself."""
    return [*words(out, LONG), "--checkpoint-minutes", "0"]


def trainer(out: Path) -> tuple[Trainer, Config]:
    """What those words train with, and their configuration."""
    config = train.configuration(train.read(words(out)[1:]))
    return tiny_trainer(config), config


def run(out: Path, iterations: int = ITERATIONS, *more: str) -> tuple[int | None, str]:
    """Runs the command here, to its end: the exit code, None for a traceback, and what it wrote on stderr."""
    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
        try:
            code = command([*words(out, iterations), *more])
        except Exception:
            return None, traceback.format_exc()
    if code > 128:  # the campaign itself was to stop
        sys.exit(code)
    return code, errors.getvalue()


@cache
def whole(folder: Path) -> tuple[list[Any], list[dict[str, str]]]:
    """The run that nothing happens to: its state after every iteration, and its curves."""
    out = folder / "whole"
    learner, _ = trainer(out)
    states: list[Any] = []
    watched = Watched(learner, lambda state: states.append(jax.tree.map(np.array, jax.device_get(state))))
    start.build = lambda config: watched
    code, said = run(out, LONG)
    assert code == 0, said
    return states, _curve(out)


def kills(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Kills runs while they start, compile, train and save; then lets them end."""
    return Campaign(folder, seed).kills(count)


def corruptions(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Damages a file of a run that is half done, or moves it; then the same command goes on, or refuses."""
    return Campaign(folder, seed).corruptions(count)


def disks(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Fills the disk that a run is on; it has to end by itself in one line, and to go on when there is room."""
    return Campaign(folder, seed).disks(count)


class Campaign:
    """Injects faults; what came of them is counted.

    Attributes:
        problems: a line for every fault after which something was lost, hung, or was not told in one line.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        """Makes the run to compare with, if there is none yet."""
        self.folder, self.random = folder, random.Random(seed)
        self.problems: list[str] = []
        self.states, self.curve = whole(folder)
        self.trainer, self.config = trainer(folder / "whole")
        start.build = lambda config: self.trainer

    def kills(self, count: int) -> dict[str, Any]:
        """See :func:`kills`."""
        lost = 0
        for number in range(0, count, KILLS_OF_A_RUN):
            out = self.folder / f"killed{number}"
            for _ in range(min(KILLS_OF_A_RUN, count - number)):
                self._kill(out)
            lost += not self._goes_on(out, f"kill {number}")
            shutil.rmtree(out)
        runs = -(-count // KILLS_OF_A_RUN)
        return {"injected": count, "runs": runs, "runs_lost": lost, "problems": self.problems}

    def corruptions(self, count: int) -> dict[str, Any]:
        """See :func:`corruptions`."""
        half = self.folder / "half"
        assert run(half, ITERATIONS // 2)[0] == 0
        found: dict[str, Any] = dict.fromkeys(("injected", "went_on", "refused", "tracebacks", "wrong", "wrote"), 0)
        for number in range(count):
            out = self.folder / "damaged"
            shutil.copytree(half, out)
            what = self._damage(out)
            before = places.content(out)
            code, said = run(out)
            found["injected"] += 1
            if code == 0:
                kind = "went_on" if self._same(out, ITERATIONS) else "wrong"
            else:
                kind = "tracebacks" if code is None or len(said.splitlines()) != 1 else "refused"
                kind = "wrote" if kind == "refused" and places.content(out) != before else kind
            found[kind] += 1
            if kind not in ("went_on", "refused"):
                self.problems.append(f"corruption {number}: {what}: {kind}: {said[-500:]}")
            shutil.rmtree(out)
        return found | {"problems": self.problems}

    def disks(self, count: int) -> dict[str, Any]:
        """See :func:`disks`."""
        ended = went_on = 0
        for number in range(count):
            with places.disk(self.folder) as disk:
                out = disk / "run"
                limit = None if os.path.ismount(disk) else self.random.randint(20_000, 40_000)
                child = children.started(_saving(out), limit)
                self._await(lambda child=child: child.poll() is None, out, self.random.randint(1, 10))
                if os.path.ismount(disk):
                    places.fill(disk, self.random.choice((0, 4096, 20_000)))
                try:
                    said = child.communicate(timeout=LIMIT)[1]
                except subprocess.TimeoutExpired:
                    said = "it hangs"
                    child.kill()
                    child.communicate()
                if child.returncode == 1 and len(said.splitlines()) == 1:
                    ended += 1
                else:
                    self.problems.append(f"disk {number}: exit code {child.returncode}: {said[-500:]}")
                (disk / "filler").unlink(missing_ok=True)
                went_on += self._goes_on(out, f"disk {number}")
        return {"injected": count, "ended": ended, "went_on": went_on, "problems": self.problems}

    def _await(self, alive: Callable[[], bool], out: Path, more: int) -> None:
        """Waits until a run has made more rows, or ends."""
        first, end = len(metrics_csv.read(out / "metrics.csv")), time.monotonic() + LIMIT
        while alive() and time.monotonic() < end and len(metrics_csv.read(out / "metrics.csv")) < first + more:
            time.sleep(0.02)

    def _kill(self, out: Path) -> None:
        """Starts a process and kills it: at its work, or at any time from its start."""
        working = self.random.random() < 0.7
        if self.random.random() < WHOLE:
            popen = children.started(_saving(out))
            kill, wait, alive = popen.kill, popen.communicate, lambda: popen.poll() is None
        else:
            process = children.forked(_saving(out))
            kill, wait, alive = process.kill, process.join, process.is_alive
        if working:
            self._await(alive, out, self.random.randint(1, 4))
        time.sleep(self.random.uniform(0.0, 2.0))
        kill()
        wait()

    def _goes_on(self, out: Path, what: str) -> bool:
        iterations = min(LONG, checkpoint.newest(out) // PER_ITERATION + MORE)
        code, said = run(out, iterations)
        if code == 0 and self._same(out, iterations):
            return True
        self.problems.append(f"{what}: it does not go on: exit code {code}: {said[-500:]}")
        return False

    def _same(self, out: Path, iterations: int) -> bool:
        """Whether a run's state and curves are those of the run that nothing happened to."""
        found = checkpoint.restore(out, self.trainer.init(), self.config, lambda text: None)
        if found is None or found[1] != iterations * PER_ITERATION:
            return False
        leaves = zip(jax.tree.leaves(found[0]), jax.tree.leaves(self.states[iterations - 1]), strict=True)
        return _curve(out) == self.curve[:iterations] and all(
            np.array_equal(np.asarray(a), b, equal_nan=True) for a, b in leaves
        )

    def _damage(self, out: Path) -> str:
        """Harms one thing of a run; in words."""
        entries = sorted(path for path in out.rglob("*") if path.is_file() and path.parent.name != "tensorboard")
        # Half of them where a run keeps few files but needs them.
        few = [path for path in entries if path.parent in (out, *out.glob("checkpoints/*"))]
        path = self.random.choice(few if self.random.random() < 0.5 else entries)
        name = self.random.choice(list(harms.HARMS))
        harms.HARMS[name](path, self.random)
        return f"{name} of {path.relative_to(out)}"


class Watched:
    """A learner whose state somebody is shown after every iteration."""

    def __init__(self, learner: Any, show: Callable[[Any], None]) -> None:
        self.init, self.make_pool, self._learner, self._show = learner.init, learner.make_pool, learner, show

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def iterate(self, state: Any, pool: Any) -> Any:
        """As the learner's."""
        state, metrics = self._learner.iterate(state, pool)
        self._show(state)
        return state, metrics


def _curve(out: Path) -> list[dict[str, str]]:
    """The rows of a run, without the times."""
    found = metrics_csv.filled(metrics_csv.read(out / "metrics.csv"))
    return [{name: cell for name, cell in row.items() if not name.startswith("time/")} for row in found]
