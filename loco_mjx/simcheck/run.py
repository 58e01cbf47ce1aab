"""Runs a policy's folder on both sides and puts their figures next to one another."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

from loco_mjx import config as config_lib
from loco_mjx.config import EnvConfig
from loco_mjx.deploy import folder
from loco_mjx.deploy.observer import check_readable
from loco_mjx.deploy.session import Session
from loco_mjx.env.action import neutral
from loco_mjx.env.loco_env import LocoEnv
from loco_mjx.env.state import State
from loco_mjx.errors import UserError
from loco_mjx.evaluation.episodes import Figures, Tally, evaluation_config, figures
from loco_mjx.run import needs, provenance
from loco_mjx.scene.tasks import get_task
from loco_mjx.sharding import dividing_devices, make_mesh
from loco_mjx.simcheck.follow import make_follower
from loco_mjx.simcheck.replay import Recorder, Replayed, replay
from loco_mjx.simcheck.sides import CSide, MjxSide, start

Tick = Callable[[str, int, int], None]  # a side's name, control steps done, of how many
Watch = Callable[[int, State, State, np.ndarray], None]
REPLAY = "C MuJoCo, replays"


class Side(Protocol):
    """A world in which the episodes run side by side."""

    name: str

    def begin(self, state: State) -> State:
        """Takes the episodes' first states."""
        ...

    def step(self, state: State, t: int, alive: np.ndarray) -> State:
        """Control step t of the episodes that are alive (episodes,)."""
        ...


def simcheck(
    policy: Path,
    task: str | None,
    episodes: int,
    seed: int,
    tick: Tick,
    solver: tuple[int, int] | None = None,
    prisms: bool = False,
) -> dict[str, Any]:
    """Compares the two sides on the same scenes, from the same starts, with the same exported policy.

    Args:
        policy: folder that `loco-mjx export` wrote.
        task: to run on; None: the one it was trained on.
        episodes: how many; a fall ends one, as in training.
        seed: of the scenes and starts; episode i is the one of `loco-mjx evaluate` with the same seed.
        tick: told about progress.
        solver: Newton and line-search iterations of MJX's side; None: those of training.
        prisms: leave C's own contacts with a heightfield; see :mod:`loco_mjx.deploy.terrain_contacts`.

    Returns:
        What was run, `metrics` (see :func:`compare`), `replay` with the same of seconds begun in the same state (see
        :mod:`loco_mjx.simcheck.replay`), and `episodes` with each one's figures on both sides.

    Raises:
        UserError: if the folder cannot be used, the task is unknown, or there are no episodes or iterations to run.
    """
    if task is not None:
        get_task(task)
    if episodes < 1:
        raise UserError(f"episodes is {episodes}; accepted: 1 or more")
    manifest = folder.read(policy)
    check_readable(manifest, position_known=True)
    session = Session(manifest, policy)
    config = _environment(policy, manifest, task, solver)
    env = LocoEnv(config)
    mesh = make_mesh(dividing_devices(episodes))
    make_follower(manifest, env.robot)  # which may lack a library
    first = start(env, seed, episodes)
    found, seconds, recorder = {}, {}, Recorder(manifest.hold, env.task.moving, neutral(config))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        c = CSide(env, manifest, session, pool, prisms)
        for side, watch in ((MjxSide(env, manifest, session, pool, mesh), recorder), (c, None)):
            begin = time.perf_counter()
            found[side.name] = run(side, first, config.horizon, env.dt, tick, watch)
            seconds[side.name] = time.perf_counter() - begin
        again = replay(recorder.windows, c.robots, manifest, session, pool, partial(tick, REPLAY))
    return {
        "policy": manifest.policy,
        "trained_on": manifest.raw["training"]["task"],
        "samples": manifest.raw["training"]["samples"],
        "task": config.task,
        "num_episodes": episodes,
        "seed": seed,
        "prisms": prisms,
        "physics": config_lib.to_dict(config.physics),
        "metrics": compare(found[CSide.name], found[MjxSide.name]),
        "replay": replay_figures(again) | {"output": manifest.controller.output, "unit": manifest.controller.unit},
        "episodes": {name: {key: values.tolist() for key, values in found[name].items()} for name in found},
        "seconds": seconds,
        "versions": provenance.versions(),
    }


def _environment(
    policy: Path, manifest: folder.Manifest, task: str | None, solver: tuple[int, int] | None
) -> EnvConfig:
    """That of an evaluation of the run which the policy is from, with its robot and the solver asked for."""
    trained = config_lib.from_dict(config_lib.Config, manifest.raw["config"])
    trained = dataclasses.replace(trained, env=dataclasses.replace(trained.env, robot=manifest.body))
    needs.check(trained, policy)
    config = evaluation_config(trained.env, task)
    if solver is None:
        return config
    physics = dataclasses.replace(config.physics, iterations=solver[0], ls_iterations=solver[1])
    return dataclasses.replace(config, physics=physics)


def replay_figures(again: Replayed) -> dict[str, Any]:
    """What came of the replays, as :func:`compare` has it; `targets` is None for a policy that holds depth too long."""
    count = len(again.targets)
    if not count:
        return {"windows": 0}
    compared = not np.isnan(again.targets).any()
    away = {"mean": float(again.targets.mean()), "max": float(again.targets.max())} if compared else None
    return {"windows": count, "seconds": again.seconds, "targets": away} | compare(again.c, again.mjx)


def run(side: Side, first: State, horizon: int, control_dt: float, tick: Tick, watch: Watch | None = None) -> Figures:
    """Each metric of each episode, (episodes,): summed up to its first `done`, as an evaluation does it.

    Args:
        side: the world.
        first: states of the episodes.
        horizon: control steps of the longest.
        control_dt: s, duration of a control step.
        tick: told about progress.
        watch: shown every step: its number, the states before and after it, and which episodes go on.
    """
    state, tally, count = side.begin(first), Tally.start(first, control_dt), jax.jit(Tally.add)
    for t in range(horizon):
        alive = np.asarray(tally.alive)
        if not alive.any():
            break
        before, state = state, side.step(state, t, alive)
        tally = count(tally, state)
        if watch is not None:
            watch(t, before, state, np.asarray(tally.alive))
        tick(side.name, t + 1, horizon)
    return figures(jax.device_get(tally.sums))


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
