"""What is learnt in minutes with a teacher: ``python -m experiments.taught``.

LocoTransformer, and once a blind policy, by `loco-mjx train --method distill`, and beside it LocoTransformer by PPO
alone; every run resumes, so the command can be typed again. Results go to ``experiments/results/cpu/taught/``.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from experiments import committed
from experiments.learning import evaluate
from loco_mjx.config import DistillConfig

SEEING = "loco-transformer"
RESULTS = committed.RESULTS / "taught"
ELSEWHERE = {"mountain": (), "thin": ("wide",), "wide": ("thin",), "thin-sphere": (), "wide-sphere": (), "moving": ()}


@dataclass(frozen=True)
class Run:
    """One training run.

    Attributes:
        task: to train on.
        seed: of everything random.
        policy: to train.
        samples: of it. None: the default.
        method: distill, or ppo, which is the paper's.
        free: whether collisions cost the teacher nothing.
        ratio: samples of its teacher for each of them.
        average: decay of the mean over iterations that its parameters are, and its teacher's; 0: they are the last.
        falling: whether its teacher's learning rate falls to 0.
    """

    task: str
    seed: int
    policy: str = SEEING
    samples: int | None = None
    method: str = "distill"
    free: bool = False
    ratio: float = DistillConfig.teacher_ratio
    average: float = 0.0
    falling: bool = False

    @property
    def name(self) -> str:
        """Name of its directories."""
        marks = [self.task, *([self.policy] if self.policy != SEEING else [])]
        given = {"ppo": self.method == "ppo", "free": self.free, f"x{self.ratio:g}": self.ratio != type(self).ratio}
        given |= {"falling": self.falling}
        marks += [mark for mark, is_so in given.items() if is_so]
        return "-".join([*marks, f"seed{self.seed}"])


FREE = ("--distill.teacher-collision", "0")
PIXELS = 458_752  # samples of PPO from pixels: 13 to 14 minutes of two quiet cores
RUNS = tuple(Run("mountain", seed) for seed in (0, 1, 2))
RUNS += tuple(Run("thin", seed, samples=376_832) for seed in (0, 1, 2))
RUNS += (Run("thin", 0, samples=376_832, free=True),)
RUNS += tuple(Run("mountain", seed, samples=PIXELS, method="ppo") for seed in (0, 1, 2))
RUNS += (Run("mountain", 0, "state-only"),)
RUNS += (Run("mountain", 0, samples=1_000_000, ratio=8.0, average=0.95),)
RUNS += tuple(
    Run(task, seed, samples=352_256, ratio=16.0, average=0.9) for task in ("mountain", "thin") for seed in (0, 1, 2)
)
RUNS += tuple(Run("mountain", seed, samples=147_456, ratio=30.0, average=0.9) for seed in (0, 1, 2))
RUNS += (Run("mountain", 0, samples=352_256, ratio=16.0, average=0.9, falling=True),)
RUNS += tuple(Run(task, 0, samples=376_832) for task in ("moving", "wide", "thin-sphere", "wide-sphere"))


def train(run: Run, directory: Path) -> None:
    """Trains the teacher and its pupil, or goes on training."""
    command = ["--task", run.task, "--policy", run.policy, "--method", run.method, "--seed", str(run.seed)]
    command += ["--total-steps", str(run.samples)] if run.samples else []
    command += FREE if run.free else ()
    if run.method == "distill":
        command += ["--distill.teacher-ratio", str(run.ratio), "--ppo.average", str(run.average)]
        command += ["--ppo.learning-rate-decay", str(run.falling)]
    command += ["--out", str(directory)]
    subprocess.run([sys.executable, "-m", "loco_mjx.cli.main", "train", *command], check=True)


def keep(run: Run, directory: Path) -> None:
    """Evaluates a run, and copies what the documents need into the results."""
    tasks = (*ELSEWHERE[run.task], run.task)  # its own last: what `experiments.ship` takes
    results = {f"evaluation-{task}": evaluate(directory, task) for task in tasks}
    committed.keep(directory, RESULTS / run.name, results)
    if run.method == "distill":
        shutil.copyfile(directory / "teacher" / "metrics.csv", RESULTS / run.name / "teacher-metrics.csv")


def main() -> None:
    """Runs the experiments that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[run.name for run in RUNS], help="runs, e.g. mountain-seed0")
    parser.add_argument("--runs", type=Path, default=Path("runs/taught"), help="where the run directories are")
    parser.add_argument("--keep-only", action="store_true", help="train nothing; evaluate and keep what is trained")
    options = parser.parse_args()
    from loco_mjx.run import machine

    machine.set_up()
    for run in committed.chosen(options.names, RUNS):
        if not options.keep_only:
            train(run, options.runs / run.name)
        keep(run, options.runs / run.name)


if __name__ == "__main__":
    main()
