"""Runs a policy's folder on both sides and puts their figures next to one another."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from brax.envs.base import State

from loco_mjx import config as config_lib
from loco_mjx.deploy import folder
from loco_mjx.deploy.session import Session
from loco_mjx.env.loco_env import LocoEnv
from loco_mjx.errors import UserError
from loco_mjx.evaluation.episodes import Figures, evaluation_config, figures
from loco_mjx.mesh import dividing, make_mesh
from loco_mjx.run import about
from loco_mjx.scene.tasks import get_task
from loco_mjx.simcheck.sides import CSide, MjxSide, start

Tick = Callable[[str, int, int], None]  # a side's name, control steps done, of how many


class Side(Protocol):
    """A world in which the episodes run side by side."""

    name: str

    def begin(self, state: State) -> State:
        """Takes the episodes' first states."""
        ...

    def step(self, state: State, t: int, alive: np.ndarray) -> State:
        """Control step t of the episodes that are alive (episodes,)."""
        ...


def simcheck(policy: Path, task: str | None, episodes: int, seed: int, tick: Tick) -> dict[str, Any]:
    """Compares the two sides on the same scenes, from the same starts, with the same exported policy.

    Args:
        policy: folder that `loco-mjx export` wrote.
        task: to run on; None: the one it was trained on.
        episodes: how many; a fall ends one, as in training.
        seed: of the scenes and starts; episode i is the one of `loco-mjx evaluate` with the same seed.
        tick: told about progress.

    Returns:
        What was run, `metrics` (see :func:`compare`), and `episodes` with each one's figures on both sides.

    Raises:
        UserError: if the folder cannot be used, the task is unknown, or there are no episodes to run.
    """
    if task is not None:
        get_task(task)
    if episodes < 1:
        raise UserError(f"episodes is {episodes}; accepted: 1 or more")
    manifest = folder.read(policy)
    session = Session(manifest, policy)
    config = evaluation_config(_trained(policy, manifest), task)
    env = LocoEnv(config)
    mesh = make_mesh(dividing(episodes))
    first = start(env, seed, episodes)
    found, seconds = {}, {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for side in (MjxSide(env, manifest, session, pool, mesh), CSide(env, manifest, session, pool)):
            begin = time.perf_counter()
            found[side.name] = run(side, first, config.horizon, tick)
            seconds[side.name] = time.perf_counter() - begin
    return {
        "policy": manifest.policy,
        "trained_on": manifest.raw["training"]["task"],
        "samples": manifest.raw["training"]["samples"],
        "task": config.task,
        "num_episodes": episodes,
        "seed": seed,
        "physics": config_lib.to_dict(config.physics),
        "metrics": compare(found[CSide.name], found[MjxSide.name]),
        "episodes": {name: {key: values.tolist() for key, values in found[name].items()} for name in found},
        "seconds": seconds,
        "versions": about.versions(),
    }


def _trained(path: Path, manifest: folder.Manifest) -> config_lib.EnvConfig:
    try:
        return config_lib.from_dict(config_lib.Config, dict(manifest.raw["config"])).env
    except (KeyError, TypeError) as error:
        raise UserError(f"{path / folder.MANIFEST} has no usable 'config' ({error}); export the run again") from error


def run(side: Side, first: State, horizon: int, tick: Tick) -> Figures:
    """Each metric of each episode, (episodes,): summed up to its first `done`, as an evaluation does it."""
    state = side.begin(first)
    alive = np.ones(len(first.done), bool)
    zero = np.zeros(len(alive))
    sums = {name: zero.copy() for name in [*first.metrics, "return", "length", "survived"]}
    for t in range(horizon):
        if not alive.any():
            break
        state = side.step(state, t, alive)
        done = np.asarray(state.done) > 0
        survived = done * np.asarray(state.info["truncation"])
        values = dict(state.metrics) | {"return": state.reward, "length": zero + 1, "survived": survived}
        for name, value in values.items():
            sums[name] += np.where(alive, np.asarray(value, np.float64), 0.0)
        alive &= ~done
        tick(side.name, t + 1, horizon)
    return figures(sums)


def compare(c: Figures, mjx: Figures) -> dict[str, dict[str, float | None]]:
    """Per metric: mean and std of each side, C's mean over MJX's, and the paired difference with its standard error.

    The episodes come in pairs, each of the same scene and start, so the error is that of the mean of the pairs'
    differences. A ratio to zero is None.
    """
    rows = {}
    for name in mjx:
        difference = c[name] - mjx[name]
        count, mean = len(difference), float(np.mean(mjx[name]))
        rows[name] = {
            "c_mean": float(np.mean(c[name])),
            "c_std": float(np.std(c[name])),
            "mjx_mean": mean,
            "mjx_std": float(np.std(mjx[name])),
            "ratio": float(np.mean(c[name])) / mean if mean else None,
            "difference": float(np.mean(difference)),
            "standard_error": float(np.std(difference, ddof=1) / np.sqrt(count)) if count > 1 else None,
        }
    return rows
