"""What the robots beside the A1 learn: ``python -m experiments.robots``.

A blind policy on `thin` for each; every run resumes, so the command can be typed again. Results go to
``experiments/results/cpu/robots/``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from experiments import committed

RESULTS = committed.RESULTS / "robots"
TASK, POLICY, SAMPLES = "thin", "state-only", 655_360
EPISODES, SEED = 64, 7  # of the evaluation
ROBOTS = ("go1", "go2")


def train(robot: str, directory: Path) -> None:
    """Trains, or goes on training, in a directory, with the `fast` preset."""
    command = ["--task", TASK, "--policy", POLICY, "--robot", robot, "--seed", "0"]
    command += ["--total-steps", str(SAMPLES), "--out", str(directory)]
    subprocess.run([sys.executable, "-m", "loco_mjx.cli.main", "train", *command], check=True)


def keep(robot: str, directory: Path) -> None:
    """Evaluates a run, and copies what the documents need into the results."""
    from loco_mjx.evaluation import report

    result = report.evaluate(directory, episodes=EPISODES, seed=SEED)
    result.pop("run", None)  # a path of the machine it ran on
    committed.keep(directory, RESULTS / f"{robot}-{TASK}-{POLICY}-seed0", {"evaluation": result})
    figures = result["metrics"]["distance"]
    print(f"{robot}: {figures['mean']:.2f} ± {figures['std']:.2f} m")


def main() -> None:
    """Trains and evaluates the robots that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(ROBOTS), help="robots")
    parser.add_argument("--runs", type=Path, default=Path("runs/robots"), help="where the run directories are")
    parser.add_argument("--keep-only", action="store_true", help="train nothing; evaluate and keep what is trained")
    options = parser.parse_args()
    from loco_mjx.run import machine

    machine.set_up()
    for robot in options.names:
        directory = options.runs / f"{robot}-{TASK}-{POLICY}-seed0"
        if not options.keep_only:
            train(robot, directory)
        keep(robot, directory)


if __name__ == "__main__":
    main()
