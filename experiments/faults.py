"""What training survives: ``python -m experiments.faults``, or with ``--small`` a tenth of it.

Tiny runs of the real command are killed at random moments, their files are damaged, and their disk fills up; then the
same command goes on. It has to end like a run that nothing happened to, bit for bit, or to refuse in one line and write
nothing. Figures go to ``experiments/results/faults.json``, with every case in which it did neither.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from loco_mjx.cli import train
from loco_mjx.cli.main import main as command
from loco_mjx.run import about, checkpoint, machine, rows, start
from tests.run.tiny import tiny_trainer

RESULT = Path(__file__).parent / "results" / "faults.json"
ROOT = Path(__file__).parents[1]
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
DISK_BYTES = 4_000_000
KILLS_OF_A_RUN = 5
LIMIT = 120.0  # s, after which a process counts as hanging


def words(out: Path, iterations: int = ITERATIONS) -> list[str]:
    """The command that trains a run."""
    return [*WORDS, "--total-steps", str(PER_ITERATION * iterations), "--out", str(out)]


class Campaign:
    """Injects faults; what came of them is counted.

    Attributes:
        problems: a line for every fault after which something was lost, hung, or was not told in one line.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        """Trains the run that nothing happens to, and keeps its state after every iteration."""
        self.folder, self.random = folder, random.Random(seed)
        self.problems: list[str] = []
        whole = folder / "whole"
        config = train.configuration(train.read(words(whole)[1:]))
        self.trainer, self.config = tiny_trainer(config), config
        keeping = Keeping(self.trainer)
        start.build = lambda config: keeping
        assert self.run(whole, LONG)[0] == 0
        start.build = lambda config: self.trainer
        self.states, self.curve = keeping.states, _curve(whole)

    def run(self, out: Path, iterations: int = ITERATIONS) -> tuple[int | None, str]:
        """Runs the command here, to its end: the exit code, None for a traceback, and what it wrote on stderr."""
        errors = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            try:
                code = command(words(out, iterations))
            except Exception:
                return None, traceback.format_exc()
        if code > 128:  # the campaign itself was to stop
            sys.exit(code)
        return code, errors.getvalue()

    def kills(self, count: int) -> dict[str, int]:
        """Kills runs while they start, compile, train and save; then lets them end."""
        lost = 0
        for number in range(0, count, KILLS_OF_A_RUN):
            out = self.folder / f"killed{number}"
            for _ in range(min(KILLS_OF_A_RUN, count - number)):
                child = self._child(out)
                if self.random.random() < 0.7:  # at its work, otherwise at any time from its start
                    self._await(child, out, self.random.randint(1, 4))
                time.sleep(self.random.uniform(0.0, 2.0))
                child.send_signal(signal.SIGKILL)
                child.communicate()
            lost += not self._goes_on(out, f"kill {number}")
            shutil.rmtree(out)
        return {"injected": count, "runs_lost": lost}

    def corruptions(self, count: int) -> dict[str, int]:
        """Damages a file of a run that is half done, or moves it; then the same command goes on, or refuses."""
        half = self.folder / "half"
        assert self.run(half, ITERATIONS // 2)[0] == 0
        found = dict.fromkeys(("injected", "went_on", "refused", "tracebacks", "wrong", "wrote"), 0)
        for number in range(count):
            out = self.folder / "damaged"
            shutil.copytree(half, out)
            what = self._damage(out)
            before = _content(out)
            code, said = self.run(out)
            found["injected"] += 1
            if code == 0:
                kind = "went_on" if self._same(out, ITERATIONS) else "wrong"
            else:
                kind = "tracebacks" if code is None or len(said.splitlines()) != 1 else "refused"
                kind = "wrote" if kind == "refused" and _content(out) != before else kind
            found[kind] += 1
            if kind not in ("went_on", "refused"):
                self.problems.append(f"corruption {number}: {what}: {kind}: {said[-500:]}")
            shutil.rmtree(out)
        return found

    def disks(self, count: int) -> dict[str, int]:
        """Fills the disk that a run is on; it has to end by itself in one line, and to go on when there is room."""
        ended = went_on = 0
        for number in range(count):
            with _disk(self.folder) as disk:
                out = disk / "run"
                child = self._child(out, None if os.path.ismount(disk) else self.random.randint(20_000, 40_000))
                self._await(child, out, self.random.randint(1, 10))
                if os.path.ismount(disk):
                    _fill(disk, self.random.choice((0, 4096, 20_000)))
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
        return {"injected": count, "ended": ended, "went_on": went_on}

    def _child(self, out: Path, limit: int | None = None) -> subprocess.Popen[str]:
        program = [sys.executable, "-m", "tests.run.child", "1", "60", *words(out, LONG), "--checkpoint-minutes", "0"]
        ulimit = None if limit is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        return subprocess.Popen(
            program, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=ulimit
        )

    def _await(self, child: subprocess.Popen[str], out: Path, more: int) -> None:
        """Waits until a run has made more rows, or ends."""
        first, end = len(rows.read(out / "metrics.csv")), time.monotonic() + LIMIT
        while child.poll() is None and time.monotonic() < end and len(rows.read(out / "metrics.csv")) < first + more:
            time.sleep(0.02)

    def _goes_on(self, out: Path, what: str) -> bool:
        iterations = min(LONG, checkpoint.newest(out) // PER_ITERATION + MORE)
        code, said = self.run(out, iterations)
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
        name = self.random.choice(list(HARMS))
        HARMS[name](path, self.random)
        return f"{name} of {path.relative_to(out)}"


def _flip(path: Path, numbers: random.Random) -> None:
    content = bytearray(path.read_bytes() or b"\0")
    content[numbers.randrange(len(content))] ^= 1 << numbers.randrange(8)
    path.write_bytes(content)


def _cut(path: Path, numbers: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: numbers.randrange(len(content) or 1)])


def _overwrite(path: Path, numbers: random.Random) -> None:
    path.write_bytes(numbers.randbytes(max(1, path.stat().st_size)))


def _extend(path: Path, numbers: random.Random) -> None:
    path.write_bytes(path.read_bytes() + numbers.randbytes(numbers.randint(1, 100)))


def _become_folder(path: Path, numbers: random.Random) -> None:
    path.unlink()
    path.mkdir()


def _link_to_itself(path: Path, numbers: random.Random) -> None:
    path.unlink()
    path.symlink_to(path)


def _rename_parent(path: Path, numbers: random.Random) -> None:
    """Gives a checkpoint another step's name; of other files, themselves another name."""
    if path.parent.name.isdigit():
        path.parent.rename(path.parent.with_name(f"{PER_ITERATION * numbers.randint(1, 2 * ITERATIONS):012d}.tmp"))
        (moved,) = path.parent.parent.glob("*.tmp")
        target = moved.with_suffix("")
        shutil.rmtree(target, ignore_errors=True)
        moved.rename(target)
    else:
        path.rename(path.with_name(path.name + ".moved"))


HARMS: dict[str, Callable[[Path, random.Random], None]] = {
    "a flipped bit": _flip,
    "a cut": _cut,
    "random bytes instead": _overwrite,
    "random bytes more": _extend,
    "removal": lambda path, numbers: path.unlink(),
    "emptying": lambda path, numbers: path.write_bytes(b""),
    "a folder instead": _become_folder,
    "a link to itself instead": _link_to_itself,
    "another name": _rename_parent,
}


class Keeping:
    """A learner that keeps its state after every iteration."""

    def __init__(self, learner: Any) -> None:
        self.init, self.make_pool, self._learner = learner.init, learner.make_pool, learner
        self.states: list[Any] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)

    def iterate(self, state: Any, pool: Any) -> Any:
        """As the learner's."""
        state, metrics = self._learner.iterate(state, pool)
        self.states.append(jax.tree.map(np.array, jax.device_get(state)))
        return state, metrics


def _curve(out: Path) -> list[dict[str, str]]:
    """The rows of a run, without the times."""
    found = rows.filled(rows.read(out / "metrics.csv"))
    return [{name: cell for name, cell in row.items() if not name.startswith("time/")} for row in found]


def _content(folder: Path) -> dict[str, bytes | None]:
    """Every file below a folder; the lock, which holds nothing, is left out."""
    found = (path for path in folder.rglob("*") if path.name != "lock")
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in found}


@contextlib.contextmanager
def _disk(folder: Path) -> Iterator[Path]:
    """A small disk of its own where we may mount one; elsewhere a folder."""
    disk = folder / "disk"
    disk.mkdir()
    mounted = os.geteuid() == 0
    if mounted:
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", disk]).returncode == 0
    try:
        yield disk
    finally:
        if mounted:
            subprocess.run(["umount", disk], check=True)
        shutil.rmtree(disk)


def _fill(disk: Path, left: int) -> None:
    space = os.statvfs(disk)
    with contextlib.suppress(OSError), (disk / "filler").open("wb") as file:
        file.write(bytes(max(0, space.f_bavail * space.f_frsize - left)))


def main() -> int:
    """Runs the campaign and writes its figures; 1 if anything was lost, hung or was not told in one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--small", action="store_true", help="a tenth of it")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--corruptions", type=int, default=500)
    parser.add_argument("--disks", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    machine.cores = lambda: 1  # as the processes that are killed have it
    machine.set_up(1)
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(Path(folder), options.seed)
        figures: dict[str, dict[str, int]] = {}
        for name in ("corruptions", "disks", "kills"):
            count = getattr(options, name)
            figures[name] = getattr(campaign, name)(max(1, count // 10) if options.small else count)
            print(name, figures[name], flush=True)
            more = {"seed": options.seed, "problems": campaign.problems, "about": about.about(["experiments.faults"])}
            options.out.write_text(json.dumps(figures | more, indent=1) + "\n")
    print(*campaign.problems, sep="\n")
    return int(bool(campaign.problems))


if __name__ == "__main__":
    sys.exit(main())
