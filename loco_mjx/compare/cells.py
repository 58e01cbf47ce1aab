"""What a sweep consists of: cells, each one training run and its evaluations, as commands to run."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from loco_mjx.config import Config, preset, teacher_of, with_keys
from loco_mjx.errors import UserError
from loco_mjx.run import directory, settings
from loco_mjx.run.logger import CSV, SECONDS, STEP, read_rows
from loco_mjx.run.schedule import LoopOptions
from loco_mjx.run.variant import Variant, as_options

PROGRAM = (sys.executable, "-m", "loco_mjx.cli.main")
EVALUATION_SEED = 0  # the same scenes for every policy
IMPORTS = 10.0  # s from a command to the clock of a run's curves, which starts with the first iteration


@dataclass(frozen=True)
class Cell:
    """One training run and the tasks it is evaluated on.

    Attributes:
        task: to train on.
        variant: to train.
        seed: of the run.
        path: its directory.
        config: its whole configuration.
        options: words of `loco-mjx train` beside those above.
        eval_tasks: to evaluate on.
        episodes: of each evaluation.
        loop: when it is evaluated while training.
        imports: modules that its commands load first.
    """

    task: str
    variant: Variant
    seed: int
    path: Path
    config: Config
    options: tuple[str, ...]
    eval_tasks: tuple[str, ...]
    episodes: int
    loop: LoopOptions = field(default_factory=LoopOptions)
    imports: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self.task}/{self.variant.label}/seed{self.seed}"

    @property
    def samples(self) -> int:
        """It trains on, its teacher's not counted."""
        return settings.total_samples(self.config)

    @property
    def log(self) -> Path:
        """File for what its commands print; beside the run, since a run's directory takes in nothing foreign."""
        return self.path.with_name(self.path.name + ".log")

    def train_command(self) -> list[str]:
        """Trains it, or goes on."""
        words = ["--task", self.task, *self.variant.words, "--seed", str(self.seed), "--out", str(self.path)]
        return [*PROGRAM, "train", *words, *self.options, *self._imports]

    def evaluate_command(self, task: str) -> list[str]:
        """Evaluates it on a task."""
        words = ["--task", task, "--episodes", str(self.episodes), "--seed", str(EVALUATION_SEED)]
        return [*PROGRAM, "evaluate", str(self.path), *words, *self._imports]

    @property
    def _imports(self) -> list[str]:
        return [word for module in self.imports for word in ("--import", module)]

    @property
    def teacher(self) -> Config | None:
        """The configuration of its teacher's run, for method `distill`."""
        return teacher_of(self.config) if self.config.method == "distill" else None

    @property
    def teacher_samples(self) -> int:
        """Its teacher trains on; 0 without one."""
        return 0 if self.teacher is None else settings.total_samples(self.teacher)

    def trained(self) -> bool:
        """Whether there is nothing left to train.

        Raises:
            UserError: if its directory holds another run, or something else.
        """
        from loco_mjx.run import checkpoint, start

        found = directory.find(self.path)
        if found is None:
            return False
        directory.reconcile(self.path, found, self.config)
        done = checkpoint.newest(self.path)
        if done > self.samples:
            raise UserError(
                f"{self.path} has trained on {done:,} samples already, asked for {self.samples:,}; give "
                f"--total-steps {done}, or another --out"
            )
        return start.finished(self.path, self.config)

    def unevaluated(self) -> list[str]:
        """The tasks on which the finished run has not been evaluated, with as many episodes at least."""
        return [task for task in self.eval_tasks if not self._has_evaluation(task)]

    def finished(self) -> bool:
        """Whether nothing is left to do.

        Raises:
            UserError: as `trained`.
        """
        return self.trained() and not self.unevaluated()

    def done(self) -> int:
        """Samples trained so far, as its curves have it."""
        return min(_last_step(self.path), self.samples)

    def teacher_done(self) -> int:
        """Samples its teacher has trained on so far."""
        return min(_last_step(self.path / directory.TEACHER), self.teacher_samples)

    def _has_evaluation(self, task: str) -> bool:
        path = self.path / "evaluation" / f"{task}-{self.samples}-seed{EVALUATION_SEED}.json"
        try:
            return path.is_file() and directory.read_json(path)["num_episodes"] >= self.episodes
        except (UserError, KeyError, TypeError):  # cut short: it is made again
            return False


@dataclass(frozen=True)
class Plan:
    """What every cell of a sweep shares.

    Attributes:
        out: directory; a cell's is TASK/POLICY/seedSEED in it.
        preset: of the configuration.
        total_steps: samples; None: the preset's.
        eval_tasks: to evaluate on; none: the task trained on.
        episodes: of each evaluation.
        changes: keys of every cell's configuration and their values, in words.
        loop: when cells are saved and evaluated while they train.
        imports: modules that every command loads first; they are loaded here, too.
    """

    out: Path
    preset: str = "fast"
    total_steps: int | None = None
    eval_tasks: tuple[str, ...] = ()
    episodes: int = 32
    changes: tuple[tuple[str, str], ...] = ()
    loop: LoopOptions = field(default_factory=LoopOptions)
    imports: tuple[str, ...] = ()

    def group(self, task: str, variant: Variant, seeds: Sequence[int]) -> dict[int, Cell]:
        """The cells of one policy on one task.

        Raises:
            UserError: if there is no such task, or the configuration does not fit together.
        """
        config = dataclasses.replace(preset(self.preset), policy=variant.policy)
        config = settings.complete(settings.with_task(with_keys(config, (*variant.changes, *self.changes)), task))
        if self.total_steps is not None:
            config = settings.with_total(config, self.total_steps)
        settings.check(config)
        path, eval_tasks = self.out / task / variant.label, self.eval_tasks or (task,)
        words = self._words(config.ppo.total_steps)

        def cell(seed: int) -> Cell:
            own, where = dataclasses.replace(config, seed=seed), path / f"seed{seed}"
            return Cell(task, variant, seed, where, own, words, eval_tasks, self.episodes, self.loop, self.imports)

        return {seed: cell(seed) for seed in seeds}

    def _words(self, total: int) -> tuple[str, ...]:
        """Options of `loco-mjx train` for every cell; without a total it would take what a CPU does in minutes."""
        own, usual = dataclasses.asdict(self.loop), dataclasses.asdict(LoopOptions())
        loop = [(name, str(value)) for name, value in own.items() if value != usual[name]]
        return ("--preset", self.preset, *as_options((*self.changes, *loop, ("total_steps", str(total)))))

    def cells(self, tasks: Sequence[str], variants: Sequence[Variant], seeds: Sequence[int]) -> list[Cell]:
        """Every combination; all cells of a seed come before those of the next, so that all methods progress alike.

        Raises:
            UserError: as `group`, or if there is no such task to evaluate on.
        """
        from loco_mjx.scene.tasks import get_task

        for task in self.eval_tasks:
            get_task(task)
        if self.episodes < 1:
            raise UserError(f"episodes is {self.episodes}; accepted: 1 or more")
        groups = [self.group(task, variant, seeds) for task in tasks for variant in variants]
        return [group[seed] for seed in seeds for group in groups]


def _last_step(run: Path) -> int:
    """Samples that the run in a directory has trained on, by the last row of its curves."""
    rows = read_rows(run / CSV)
    return int(rows[-1][STEP]) if rows else 0


@dataclass(frozen=True)
class Measured:
    """How fast runs were trained.

    Attributes:
        rate: samples per second, evaluations on the way included.
        start: seconds from the command to the first sample.
    """

    rate: float
    start: float


def measured(runs: Iterable[Path]) -> Measured | None:
    """How fast the runs in some directories were trained; None if none of them got beyond its first iteration.

    The first iteration includes the compilation: the time by which it is longer than the others counts as start.
    """
    samples = seconds = 0.0
    starts = []
    for run in runs:
        rows = read_rows(run / CSV)
        times = [float(row.get(SECONDS) or 0.0) for row in rows]
        if len(rows) < 2 or times[-1] <= times[0]:
            continue
        first, own = int(rows[0][STEP]), int(rows[-1][STEP]) - int(rows[0][STEP])
        samples, seconds = samples + own, seconds + times[-1] - times[0]
        starts.append(IMPORTS + max(0.0, times[0] - first * (times[-1] - times[0]) / own))
    return Measured(samples / seconds, sum(starts) / len(starts)) if starts else None
