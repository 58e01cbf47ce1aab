"""Does it learn? Trains, evaluates, and keeps the curves: ``python -m experiments.learning``.

Every run resumes, so the command can be typed again. Results go to ``experiments/results/cpu/learning/``.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

RESULTS = Path(__file__).parent / "results" / "cpu" / "learning"
EPISODES = 64


@dataclass(frozen=True)
class Run:
    """One training run.

    Attributes:
        task: to train on.
        policy: to train.
        samples: environment steps.
    """

    task: str
    policy: str
    samples: int

    @property
    def name(self) -> str:
        """Name of its directories."""
        return f"{self.task}-{self.policy}"


RUNS = (
    Run("thin", "loco-transformer", 1_024_000),
    Run("mountain", "loco-transformer", 1_024_000),
    Run("thin", "state-only", 1_600_000),
)


def train(run: Run, directory: Path) -> None:
    """Trains, or goes on training, in a directory, with the `fast` preset and seed 0."""
    command = ["--task", run.task, "--policy", run.policy, "--total-steps", str(run.samples), "--out", str(directory)]
    subprocess.run([sys.executable, "-m", "loco_mjx.cli.main", "train", *command], check=True)


def standing_still(directory: Path) -> dict[str, float]:
    """The means over the same episodes of a policy whose every parameter is zero: it holds the default pose."""
    import jax

    from loco_mjx.env import LocoEnv
    from loco_mjx.evaluation.episodes import Evaluator, evaluation_config, means
    from loco_mjx.evaluation.policy import load_policy
    from loco_mjx.mesh import make_mesh

    policy = load_policy(directory)
    config = evaluation_config(policy.config.env)
    program = Evaluator(LocoEnv(config), policy.networks, config.horizon, make_mesh())
    params = jax.tree.map(jax.numpy.zeros_like, policy.params)
    return means(program.run(params, policy.normalizer, seed=0, episodes=EPISODES))


def evaluate(directory: Path) -> dict[str, object]:
    """The trained policy's figures, as `loco-mjx evaluate` reports them, and those of standing still."""
    from loco_mjx.evaluation import report

    result = report.evaluate(directory, episodes=EPISODES)
    result["standing_still"] = standing_still(directory)
    result.pop("run", None)  # a path of the machine it ran on
    return result


def keep(run: Run, directory: Path, result: dict[str, object]) -> None:
    """Copies what the documents need into the results."""
    target = RESULTS / run.name
    target.mkdir(parents=True, exist_ok=True)
    for name in ("metrics.csv", "config.json"):
        shutil.copyfile(directory / name, target / name)
    info = json.loads((directory / "info.json").read_text())
    (target / "info.json").write_text(json.dumps(info, indent=1) + "\n")
    (target / "evaluation.json").write_text(json.dumps(result, indent=1) + "\n")


def main() -> None:
    """Runs the experiments that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[run.name for run in RUNS], help="runs, e.g. thin-state-only")
    parser.add_argument("--runs", type=Path, default=Path("runs/learning"), help="where the run directories are")
    options = parser.parse_args()
    from loco_mjx.run import machine

    chosen = [run for run in RUNS if run.name in options.names]
    for run in chosen:
        train(run, options.runs / run.name)
    machine.set_up()
    for run in chosen:
        keep(run, options.runs / run.name, evaluate(options.runs / run.name))


if __name__ == "__main__":
    main()
