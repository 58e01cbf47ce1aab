"""Policies over the whole-body controller: ``python -m experiments.high_level [train] [compare]``; none: both.

train: the four that the paper compares, transformer and CNN, on depth alone and on depth with velocity and attitude;
each resumes, so the command can be typed again. compare: 20 s in C MuJoCo through the deployment's loop, beside a
policy of joint targets; what has been run is not run again. Results go to ``experiments/results/cpu/high_level/``.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments import committed
from loco_mjx import policies
from loco_mjx.cli.deploy import PATIENCE, generated
from loco_mjx.deploy import folder
from loco_mjx.deploy.guided import Guided
from loco_mjx.deploy.record import Record
from loco_mjx.deploy.runner import Runner
from loco_mjx.deploy.session import Session
from loco_mjx.robots import get_robot
from loco_mjx.simcheck.sides import WatchedRobot

RESULTS = committed.RESULTS / "high_level"
TASK, SEED, SAMPLES = "thin", 0, 1_000_000
POLICIES = ("loco-transformer", "state-depth-concat", "depth-only", "visual-cnn")
END_TO_END = "thin"  # the shipped policy
TASKS = ("indoor", "forest", "thin", "wide", "moving")
SECONDS, EPISODES = 20.0, 10
APART = 1.0  # s without a contact after which the next one is another collision
PROGRAM = (sys.executable, "-m", "loco_mjx.cli.main")


def train(policy: str, samples: int, directory: Path) -> None:
    """Trains, or goes on training, in a directory."""
    command = ["--task", TASK, "--controller", "mpc", "--policy", policy, "--seed", str(SEED)]
    command += ["--total-steps", str(samples), "--out", str(directory)]
    done = subprocess.run([*PROGRAM, "train", *command])
    if done.returncode:  # stopped, or refused, which it has said
        raise SystemExit(done.returncode)


class Counting(WatchedRobot):
    """C MuJoCo's robot, of which is known how often it has collided.

    Attributes:
        collisions: times that some part touched an obstacle or a wall after none had for APART.
    """

    def __init__(self, model: Any, *args: Any, **more: Any) -> None:
        self.collisions, self._touched = 0, -np.inf
        super().__init__(model, *args, **more)

    def _step(self, torque: np.ndarray) -> None:
        self.forget()
        super()._step(torque)
        if self.contact:
            self.collisions += self.now() - self._touched > APART
            self._touched = self.now()


def episode(policy: Path, task: str, seed: int) -> dict[str, Any]:
    """One run of an exported policy, as `loco-mjx deploy` makes it."""
    manifest = folder.read(policy)
    model, between = generated(task, seed, manifest.body, manifest.policy_hz)
    robot = Counting(model, manifest.camera, seed=seed, between=between, policy_hz=manifest.policy_hz)
    how: dict[str, Any] = {"clock": time.thread_time, "patience": PATIENCE}
    session = Session(manifest, policy)
    runner: Runner
    if manifest.controller.name == Runner.for_controller:
        runner = Runner(manifest, session, robot, **how)
    else:
        runner = Guided(manifest, session, get_robot(manifest.body), robot, **how)
    record = runner.run(SECONDS)
    unsolved = {"unsolved": runner.unsolved} if isinstance(runner, Guided) else {}
    return {"distance": moved(record), "collisions": robot.collisions, "stopped": record.cause} | unsolved


def moved(record: Record) -> float:
    """M from where the policy began to where it was SECONDS later, or when it was stopped."""
    begin = record.rows[0]
    end = [row for row in record.rows if row["time"] <= begin["time"] + SECONDS + 1e-6][-1]
    return float(np.linalg.norm(end["position"] - begin["position"]))


def compare(name: str, policy: Path, tasks: list[str], episodes: int) -> None:
    """Runs a policy in scenes of some tasks, the same ones for every policy, and keeps what came of it."""
    manifest = folder.read(policy)
    training = manifest.raw["training"]
    about = {"name": name, "policy": manifest.policy, "controller": manifest.controller.name}
    about |= {"trained_on": training["task"], "samples": training["samples"], "seconds": SECONDS, "apart": APART}
    about["sha256"] = manifest.raw["files"][folder.ONNX]["sha256"]
    for task in tasks:
        path = RESULTS / "compare" / f"{name}-{task}.json"
        if path.exists() and json.loads(path.read_text()) | about == json.loads(path.read_text()):
            rows = json.loads(path.read_text())["rows"]
        else:
            rows = []
        # As many as there are already, or more: what has been run is not thrown away.
        rows += [episode(policy, task, seed) for seed in range(len(rows), episodes)]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(about | {"task": task, "rows": rows}, indent=1) + "\n")
        means = {key: float(np.mean([row[key] for row in rows])) for key in ("distance", "collisions")}
        print(f"{name} on {task}: {means['distance']:.1f} m, {means['collisions']:.1f} collisions", flush=True)


def exported(directory: Path, out: Path) -> Path:
    """A run's policy as a folder, written again wherever it has been trained on since."""
    subprocess.run([*PROGRAM, "export", str(directory), "--out", str(out)], check=True)
    return out


def main() -> None:
    """Does what the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=["train", "compare", []], help="what; all if none")
    parser.add_argument("--policies", default=",".join(POLICIES), help="of the four, joined by commas")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="to train each on")
    parser.add_argument("--end-to-end", type=Path, default=Path(END_TO_END), help="a run, a policy's folder, or a name")
    parser.add_argument("--tasks", default=",".join(TASKS), help="to compare on, joined by commas")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="of each comparison")
    parser.add_argument("--runs", type=Path, default=Path("runs/high_level"), help="where the run directories are")
    options = parser.parse_args()
    parts, names = options.parts or ["train", "compare"], options.policies.split(",")
    for policy in names if "train" in parts else []:
        train(policy, options.samples, options.runs / policy)
        committed.keep(options.runs / policy, RESULTS / "runs" / f"{policy}-seed{SEED}")
    if "compare" in parts:
        own = policies.find(options.end_to_end)
        if not (own / folder.MANIFEST).is_file():
            own = exported(own, options.runs / "policies" / "end-to-end")
        folders = {"end-to-end": own}
        folders |= {name: exported(options.runs / name, options.runs / "policies" / name) for name in names}
        for name, policy in folders.items():
            compare(name, policy, options.tasks.split(","), options.episodes)


if __name__ == "__main__":
    main()
