"""The package from Python: configure, train, evaluate and act, as the commands do; all of it is in ``loco_mjx``."""

from __future__ import annotations

import base64
import io
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console

from loco_mjx import config as config_lib
from loco_mjx import policies
from loco_mjx.config import Config
from loco_mjx.deploy import trained
from loco_mjx.env import LocoEnv
from loco_mjx.errors import UserError
from loco_mjx.evaluation import multi_seed, report
from loco_mjx.evaluation.episodes import evaluation_config
from loco_mjx.evaluation.in_training import evaluators
from loco_mjx.networks.outputs import DEPTH, PRIVILEGED, STATE
from loco_mjx.networks.registry import POLICIES
from loco_mjx.run import machine, settings, start
from loco_mjx.run.loop import Outcome
from loco_mjx.run.policy import TrainedPolicy
from loco_mjx.run.progress import Output
from loco_mjx.run.run_log import Run
from loco_mjx.run.schedule import LoopOptions

Callback = Callable[[int, Mapping[str, float]], object]


def configure(preset: str = "fast", keys: Mapping[str, Any] | None = None, **top: Any) -> Config:
    """A run's configuration: a preset, with some keys changed.

    ``configure("fast", {"ppo.learning_rate": 1e-4}, task="thin", policy="state-only", total_steps=100_000)``

    Args:
        preset: "paper", "fast" or "real".
        keys: values by key of the configuration, as `loco-mjx train --help-all` lists them: `env.reward.alive`.
        **top: what has no group: `policy`, `method`, `seed`; and, as on the command line, `task`, `robot`,
            `controller`, `num_envs` and `total_steps`.

    Raises:
        UserError: if a name or a key is unknown, or a value is not accepted.
    """
    short = {name: f"env.{name}" for name in ("task", "robot", "controller")}
    short |= {name: f"ppo.{name}" for name in ("num_envs", "total_steps")}
    changes = {short.get(name, name): value for name, value in top.items()} | dict(keys or {})
    config = settings.complete(config_lib.with_values(config_lib.preset(preset), changes))
    settings.check(config)
    return config


def train(
    config: Config,
    out: str | Path,
    callback: Callback | None = None,
    *,
    eval_tasks: Sequence[str] = (),
    options: LoopOptions | None = None,
    quiet: bool = False,
) -> Outcome:
    """Trains a run, or goes on with the one in its directory, until it has trained on `config.ppo.total_steps` samples.

    Call it before anything else has run on a device, or call :func:`loco_mjx.set_up` first: JAX then takes every core
    of a CPU for a device.

    Args:
        config: of the run, e.g. from :func:`configure`.
        out: the run's directory; what is found in it has to be of the same configuration.
        callback: called after every iteration with the samples so far and a dict of the iteration's metrics, by the
            names of the columns of `metrics.csv`. If it returns True, the run is saved and ends. Under method
            `distill` it is not told of the teacher, which comes first.
        eval_tasks: evaluated on besides the run's own as it learns.
        options: when to save and to evaluate.
        quiet: print nothing.

    Returns:
        The samples trained in all, and the signal that stopped it, if one did (SIGINT for the callback's).

    Raises:
        UserError: if it cannot start or go on; see :func:`loco_mjx.run.start.train`.
    """
    config = settings.complete(config)
    settings.check(config)
    options = options or LoopOptions()
    machine.set_up(machine.shards(*settings.divided(config)))
    run, console = Run(config, Path(out)), Console(file=io.StringIO()) if quiet else Output()
    return start.train([run], options, console, ["loco_mjx.train"], evaluators(options, eval_tasks), callback)


def evaluate(
    path: str | Path,
    task: str | None = None,
    episodes: int = 32,
    seed: int = 0,
    stochastic: bool = False,
    randomize: bool = False,
    step: int | str | None = None,
) -> dict[str, Any]:
    """Evaluates a policy for episodes, each in a newly generated scene; that of a run is also kept in the run.

    Args:
        path: a run's directory, one that holds the runs of several seeds, an exported policy's folder, or the name of a
            shipped policy.
        task: to evaluate on; None: the one it was trained on.
        episodes: how many.
        seed: of the scenes; the same seed gives the same episodes.
        stochastic: draw actions instead of taking their mean.
        randomize: draw dynamics, latency and blind pixels for each episode.
        step: which of a run's checkpoints: the samples trained at it, or "best"; None: the newest.

    Returns:
        What was evaluated, and `metrics`: of each its `mean` and `std` over the episodes, or over the seeds.

    Raises:
        UserError: if there is no usable policy, or what is asked cannot be done.
    """
    directory = policies.find(Path(path))
    if trained.is_exported(directory):  # a folder to be left as it is
        return report.evaluate_policy(
            trained.load(directory, step), str(path), task, episodes, seed, stochastic, randomize
        )
    run: Callable[..., dict[str, Any]] = report.evaluate
    if multi_seed.holds_seeds(directory):
        run = multi_seed.evaluate
    how = {"episodes": episodes, "seed": seed, "stochastic": stochastic, "randomize": randomize, "step": step}
    return run(directory, task, **how)


class Policy:
    """A trained policy that acts, one control step after the other.

    Attributes:
        config: of the run that trained it; `config.env` is the environment it was trained in.
        samples: it was trained on.
    """

    def __init__(self, policy: TrainedPolicy) -> None:
        """Takes a policy as :func:`loco_mjx.deploy.trained.load` gives it."""
        self.config, self.samples = policy.config, policy.samples
        self._mean, self._drawn = policy.actor(), policy.actor(deterministic=False)
        networks, teacher = self._mean.networks, POLICIES.find(self.config.policy).uses_privileged
        uses = {STATE: networks.uses_state, DEPTH: networks.uses_depth, PRIVILEGED: teacher}
        self._reads = [name for name, used in uses.items() if used]
        self._act_by_mean, self._draw = jax.jit(self._mean.act), jax.jit(self._drawn.act)
        self.reset()

    def reset(self) -> None:
        """Begins an episode: a policy that holds what it sees (`hrl`) looks anew at its next step."""
        self._step, self._held = 0, None

    def make_env(self, task: str | None = None) -> LocoEnv:
        """The environment that it was trained in, without randomisation; on its own task, or on another one."""
        return LocoEnv(evaluation_config(self.config.env, task))

    def act(self, obs: Mapping[str, Any], key: jax.Array | None = None) -> np.ndarray:
        """The action of the next control step, (..., actions) in [−1, 1], as `env.step` takes it.

        Args:
            obs: what an environment returned, such as ``state.obs``, with any leading axes (...).
            key: to draw the action with; None: the mean.

        Raises:
            UserError: if a part of the observation that it reads is missing.
        """
        missing = next((name for name in self._reads if name not in obs), None)
        if missing is not None:
            raise UserError(f"the observation has no '{missing}'; accepted: what loco_mjx.make_env's environments give")
        given = {name: jax.numpy.asarray(obs[name]) for name in obs}
        held = self._mean.start(given) if self._held is None else self._held
        act = self._act_by_mean if key is None else self._draw
        action, self._held = act(given, held, jax.numpy.asarray(self._step), key)
        self._step += 1
        return np.asarray(action)


def load_policy(path: str | Path, step: int | str | None = None) -> Policy:
    """The policy of a run, the one in an exported folder, or a shipped one by its name.

    Args:
        path: of the run or the folder, or the name.
        step: which of a run's checkpoints: the samples trained at it, or "best"; None: the newest.

    Raises:
        UserError: if there is none, or none that can be read.
    """
    return Policy(trained.load(policies.find(Path(path)), step))


@dataclass(frozen=True)
class Film:
    """A film of a policy; a notebook shows it.

    Attributes:
        path: of the file.
    """

    path: Path

    def _repr_html_(self) -> str:
        data = base64.b64encode(self.path.read_bytes()).decode()
        return f'<video controls autoplay loop muted src="data:video/mp4;base64,{data}"></video>'


def film(
    policy: str | Path,
    out: str | Path,
    task: str | None = None,
    seed: int = 0,
    seconds: float = 10.0,
    imports: Sequence[str] = (),
) -> Film:
    """Films a policy with `loco-mjx play`, in a process of its own: MuJoCo draws without a display only if told before.

    Args:
        policy: a run's directory, an exported policy's folder, or the name of a shipped policy.
        out: file for the film, .mp4, replaced if it exists.
        task: to run on; None: the one it was trained on.
        seed: of the scene.
        seconds: of simulated time.
        imports: the modules that the policy needs, as `--import` takes them.

    Raises:
        UserError: if it cannot be filmed.
    """
    words = [str(policy), "--video", str(out), "--overwrite", "--seed", str(seed), "--seconds", str(seconds)]
    words += [] if task is None else ["--task", task]
    words += [word for module in imports for word in ("--import", module)]
    # Its few steps need no accelerator, whose memory this process may hold.
    done = subprocess.run(
        [sys.executable, "-m", "loco_mjx.cli.main", "play", *words],
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UserError(lines[-1].removeprefix("loco-mjx: "))
    return Film(Path(out))
