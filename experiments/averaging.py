"""What it gives that a policy is the mean of its parameters over iterations: ``python -m experiments.averaging``.

A run with `ppo.average` keeps both, the parameters that its last iteration left and their mean. Here both are
evaluated in the same scenes, the policy's and its teacher's. Results go to ``experiments/results/cpu/averaging/``.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

from experiments import committed
from experiments.taught import RUNS
from loco_mjx.compare.markup import markdown
from loco_mjx.evaluation.display import NOTHING
from loco_mjx.scene.tasks import get_task

KEPT = committed.RESULTS / "averaging"
EPISODES, SEED = 64, 1  # scenes that no other evaluation has
WHOSE = {"policy": "the policy", "teacher": "its teacher"}
TEXT = """## The mean of a policy's parameters, on a CPU

`python -m experiments.averaging` evaluates the policy, and its teacher, of runs with `ppo.average` twice, in the same
{episodes} scenes: with the parameters that the last iteration left, and with their mean over iterations, which such a
run keeps as its policy.
"""


def compare(directory: Path) -> dict[str, Any]:
    """Metrics of the mean and of the last parameters of a run.

    Args:
        directory: of a run that kept both.
    """
    from loco_mjx.evaluation.report import evaluate_policy
    from loco_mjx.run import checkpoint, start
    from loco_mjx.run import directory as directories
    from loco_mjx.run.policy import load_policy

    policy = load_policy(directory)
    config, teacher = policy.config, directory / directories.TEACHER
    trainer = start.build_student(config, teacher) if config.method == "distill" else start.build(config)
    found = checkpoint.restore(directory, trainer.init(), config, print)
    if found is None or found[0].mean is None:
        raise SystemExit(f"{directory} has no mean of its parameters; accepted: a run with --ppo.average")
    both = {"mean": policy, "last": dataclasses.replace(policy, params=found[0].params)}
    results = {name: evaluate_policy(one, name, None, EPISODES, SEED, False, False) for name, one in both.items()}
    about = {name: results["mean"][name] for name in ("task", "samples", "num_episodes", "seed", "versions")}
    return about | {"average": config.ppo.average} | {name: one["metrics"] for name, one in results.items()}


def section() -> str:
    """Of docs/results.md; nothing where there are no results."""
    found = sorted(KEPT.glob("*.json"))
    if not found:
        return ""
    head = ["run", "whose", "samples", "decay", "parameters"]
    head += ["distance", "progress", "at the goal", "falls", "collisions"]
    body = [_line(path, name) for path in found for name in ("last", "mean")]
    return TEXT.format(episodes=EPISODES) + "\n" + markdown(head, body)


def _line(path: Path, name: str) -> list[str]:
    result = json.loads(path.read_text())
    run, whose = path.stem.rsplit("-", 1)
    figure = {metric: found["mean"] for metric, found in result[name].items()}
    goal = get_task(result["task"]).toward_goal
    there = [f"{figure['progress']:.2f}", f"{figure['reached_goal']:.0%}"] if goal else [NOTHING, NOTHING]
    first = [f"`{run}`", WHOSE[whose], f"{result['samples']:,}", f"{result['average']:g}", name]
    falls, collisions = f"{1 - figure['survived']:.0%}", f"{figure['collisions']:.0f}"
    return [*first, f"{figure['distance']:.2f}", *there, falls, collisions]


def main() -> None:
    """Evaluates the runs that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [run for run in RUNS if run.average]
    parser.add_argument("names", nargs="*", default=[run.name for run in known], help="e.g. mountain-x8-seed0")
    parser.add_argument("--runs", type=Path, default=Path("runs/taught"), help="where the run directories are")
    options = parser.parse_args()
    from loco_mjx.run import machine

    machine.set_up()
    KEPT.mkdir(parents=True, exist_ok=True)
    for name in [run.name for run in committed.chosen(options.names, known)]:
        for whose, place in (("policy", options.runs / name), ("teacher", options.runs / name / "teacher")):
            (KEPT / f"{name}-{whose}.json").write_text(json.dumps(compare(place), indent=1) + "\n")


if __name__ == "__main__":
    main()
