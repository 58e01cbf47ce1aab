"""Does it learn? Trains, evaluates, and keeps the curves: ``python -m experiments.learning``.

Every run resumes, so the command can be typed again. Results go to ``experiments/results/cpu/learning/``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from experiments import committed

RESULTS = committed.RESULTS / "learning"
EPISODES = 64
SAMPLES, MORE = 1_024_000, 2_048_000


@dataclass(frozen=True)
class Run:
    """One training run.

    Attributes:
        task: to train on.
        policy: to train.
        seed: of everything random.
        elsewhere: other tasks to evaluate on.
        samples: environment steps.
        solver: the physics' Newton and line-search iterations.
    """

    task: str
    policy: str
    seed: int = 0
    elsewhere: tuple[str, ...] = ()
    samples: int = SAMPLES
    solver: tuple[int, int] = (4, 8)

    @property
    def name(self) -> str:
        """Name of its directories."""
        longer = "" if self.samples == SAMPLES else f"-{self.samples / 1e6:.0f}M"
        return f"{self.task}-{self.policy}-seed{self.seed}{longer}"


POLICIES = ("loco-transformer", "state-only", "state-depth-concat", "depth-only")
RUNS = (
    *(Run("thin", policy, seed, ("wide",), solver=(3, 4)) for seed in (0, 1) for policy in POLICIES),
    *(Run("thin", policy, seed, ("wide",), MORE, (3, 4)) for seed in (0, 1) for policy in POLICIES[:3]),
    Run("mountain", "loco-transformer"),
)


def train(run: Run, directory: Path) -> None:
    """Trains, or goes on training, in a directory, with the `fast` preset."""
    command = ["--task", run.task, "--policy", run.policy, "--seed", str(run.seed)]
    command += ["--total-steps", str(run.samples), "--out", str(directory)]
    names = ("--env.physics.iterations", "--env.physics.ls-iterations")
    command += [word for name, value in zip(names, run.solver, strict=True) for word in (name, str(value))]
    subprocess.run([sys.executable, "-m", "loco_mjx.cli.main", "train", *command], check=True)


def standing_still(directory: Path) -> dict[str, float]:
    """The means over the same episodes of a policy whose every parameter is zero: it holds the default pose."""
    import jax

    from loco_mjx.env import LocoEnv
    from loco_mjx.evaluation.episodes import Evaluator, evaluation_config, means
    from loco_mjx.run.policy import load_policy
    from loco_mjx.sharding import make_mesh

    policy = load_policy(directory)
    config = evaluation_config(policy.config.env)
    program = Evaluator(LocoEnv(config), policy.networks, config.horizon, make_mesh())
    params = jax.tree.map(jax.numpy.zeros_like, policy.params)
    return means(program.run(params, policy.normalizer, seed=0, episodes=EPISODES))


def evaluate(directory: Path, task: str) -> dict[str, object]:
    """The trained policy's figures on a task, as `loco-mjx evaluate` reports them."""
    from loco_mjx.evaluation import report

    result = report.evaluate(directory, task=task, episodes=EPISODES)
    result.pop("run", None)  # a path of the machine it ran on
    return result


def keep(run: Run, directory: Path) -> None:
    """Evaluates a run, and copies what the documents need into the results."""
    results = {"evaluation": evaluate(directory, run.task) | {"standing_still": standing_still(directory)}}
    results |= {f"evaluation-{task}": evaluate(directory, task) for task in run.elsewhere}
    committed.keep(directory, RESULTS / run.name, results)


def main() -> None:
    """Runs the experiments that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[run.name for run in RUNS], help="runs, e.g. thin-state-only-seed0")
    parser.add_argument("--runs", type=Path, default=Path("runs/learning"), help="where the run directories are")
    parser.add_argument("--keep-only", action="store_true", help="train nothing; evaluate and keep what is trained")
    options = parser.parse_args()
    from loco_mjx.run import machine

    chosen = committed.chosen(options.names, RUNS)
    for run in chosen:
        if not options.keep_only:
            train(run, options.runs / run.name)
    machine.set_up()
    for run in chosen:
        keep(run, options.runs / run.name)


if __name__ == "__main__":
    main()
