"""From a configuration and a directory to a training run: everything that may be refused is refused before writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
from rich.console import Console

from loco_mjx.config import Config
from loco_mjx.run import about, checkpoint, directory, loop
from loco_mjx.run.progress import Reporter
from loco_mjx.run.summary import print_summary

EVALUATION_SEED = 1_000_000  # added to the run's seed: the same scenes at every evaluation of a run


def build(config: Config) -> Any:
    """The trainer of a configuration, over all local devices.

    Raises:
        UserError: if sizes do not divide over the devices, or a name is unknown.
    """
    from loco_mjx.env import LocoEnv
    from loco_mjx.mesh import make_mesh
    from loco_mjx.ppo.train import Trainer

    return Trainer(config, LocoEnv(config.env), make_mesh())


def evaluator(config: Config, trainer: Any, options: loop.LoopOptions) -> loop.Evaluate:
    """What the loop calls to see how the deterministic policy does."""
    from loco_mjx.env import LocoEnv
    from loco_mjx.evaluation.episodes import Evaluator, evaluation_config, means

    env_config = evaluation_config(config.env)
    program = Evaluator(LocoEnv(env_config), trainer.networks, env_config.horizon, trainer.mesh)
    seed = (config.seed + EVALUATION_SEED) % 2**31

    def evaluate(state: Any) -> dict[str, float]:
        return means(program.run(state.params, state.normalizer, seed, options.evaluation_episodes))

    return evaluate


def train(config: Config, path: Path, options: loop.LoopOptions, console: Console, command: list[str]) -> loop.Outcome:
    """Trains, or goes on training, in a directory.

    Args:
        config: what to train; of a run found in the directory only `total_steps` may differ.
        path: the run's directory.
        options: when to save and to evaluate.
        console: for the table and the progress.
        command: the command line, for the record.

    Raises:
        UserError: if the run cannot start; nothing is written then.
    """
    found = directory.find(path)
    if found is not None:
        directory.reconcile(path, found, config)
    trainer = build(config)
    with directory.claim(path):
        done = next(iter(checkpoint.steps(path)), 0)
        directory.record_start(path, config, about.about(command) | {"samples": done})
        parameters = count_parameters(trainer, config)
        print_summary(console, config, about.devices(), parameters)
        reporter = Reporter(console, config.ppo.iterations * config.ppo.samples_per_iteration, done)
        evaluate = evaluator(config, trainer, options) if options.evaluations else None
        try:
            return loop.run(trainer, config, path, options, reporter, evaluate)
        finally:
            reporter.close()


def count_parameters(trainer: Any, config: Config) -> int:
    """Number of parameters of a trainer's networks."""
    import jax.numpy as jp

    shapes = trainer.env.observation_size
    blank = {name: jp.zeros((1, *shape)) for name, shape in shapes.items()}
    params = jax.eval_shape(lambda: trainer.networks.init(jax.random.PRNGKey(config.seed), blank))
    return sum(leaf.size for leaf in jax.tree.leaves(params))


def finished(path: Path, config: Config) -> bool:
    """Whether the run in a directory has nothing left to train."""
    return next(iter(checkpoint.steps(path)), 0) >= config.ppo.iterations * config.ppo.samples_per_iteration
