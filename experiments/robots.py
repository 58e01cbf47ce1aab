"""What the robots beside the A1 learn: ``python -m experiments.robots``.

A blind policy on `thin` for each; every run resumes, so the command can be typed again. Results go to
``experiments/results/cpu/robots/``.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

RESULTS = Path(__file__).parent / "results" / "cpu" / "robots"
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
    target = RESULTS / f"{robot}-{TASK}-{POLICY}-seed0"
    target.mkdir(parents=True, exist_ok=True)
    for name in ("metrics.csv", "config.json"):
        shutil.copyfile(directory / name, target / name)
    info = json.loads((directory / "info.json").read_text())
    for start in (info, *info.get("resumed", [])):
        start["command"][start["command"].index("--out") + 1] = target.name  # likewise
    for name, content in (("evaluation", result), ("info", info)):
        (target / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")
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
