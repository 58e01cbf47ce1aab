"""Runs and evaluations written by hand."""

from __future__ import annotations

import csv
import dataclasses
import json

from loco_mjx.config import Config, to_dict
from loco_mjx.run.directory import write_json

VERSIONS = {"loco-mjx": "0.1.0", "jax": "0.7.2", "mujoco": "3.3.5", "mujoco-mjx": "3.3.5"}
SAMPLES = 16_384  # two iterations


def config(policy="loco-transformer", task="thin", seed=0, total=SAMPLES, **network):
    base = Config()
    return dataclasses.replace(
        base,
        policy=policy,
        seed=seed,
        env=dataclasses.replace(base.env, task=task),
        network=dataclasses.replace(base.network, **network),
        ppo=dataclasses.replace(base.ppo, total_steps=total),
    )


def write_run(folder, name=None, **options):
    """A run's directory with its configuration; returns it."""
    values = config(**options)
    path = folder / (name or f"{values.env.task}/{values.policy}/seed{values.seed}")
    write_json(path / "config.json", to_dict(values))
    return path


def write_evaluation(path, task, samples=SAMPLES, episodes=8, versions=None, name="", **metrics):
    content = {
        "task": task,
        "samples": samples,
        "num_episodes": episodes,
        "seed": 0,
        "deterministic": True,
        "randomized": False,
        "metrics": {key: {"mean": value, "std": 0.0} for key, value in metrics.items()},
        "versions": VERSIONS | (versions or {}),
    }
    file = path / "evaluation" / f"{task}{name}-{samples}-seed0.json"
    write_json(file, content)
    return file


def edit(file, **values):
    file.write_text(json.dumps(json.loads(file.read_text()) | values))


def write_curve(path, columns, rows):
    with (path / "metrics.csv").open("w") as file:
        csv.writer(file).writerows([columns, *rows])
