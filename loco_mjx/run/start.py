"""From configurations and directories to training runs: everything that may be refused is refused before writing."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

from loco_mjx.config import Config, teacher_of, to_dict
from loco_mjx.errors import UserError
from loco_mjx.run import checkpoint, collectives, directory, loop, needs, provenance, settings
from loco_mjx.run.learner import GroupLearner, Single
from loco_mjx.run.progress import Reporter
from loco_mjx.run.run_log import Run, common_step
from loco_mjx.run.summary import print_summary

Evaluators = Callable[[Sequence[Run], Any], list[loop.Evaluate]]


def build(config: Config) -> Any:
    """The trainer of a configuration, over all devices: this host's, or those of all processes of the run.

    Raises:
        UserError: if sizes do not divide over the devices, or a name is unknown.
    """
    from loco_mjx.env import LocoEnv
    from loco_mjx.ppo.trainer import Trainer
    from loco_mjx.sharding import make_mesh

    return Trainer(config, LocoEnv(config.env), make_mesh())


def build_student(config: Config, teacher: Path) -> Any:
    """As :func:`build`, for method `distill`; `teacher` is the finished run of its teacher."""
    from loco_mjx.env import LocoEnv
    from loco_mjx.ppo.distill import DistillTrainer, Teacher
    from loco_mjx.run.policy import load_policy
    from loco_mjx.sharding import make_mesh

    learnt = load_policy(teacher)
    given = jax.device_get((learnt.params, learnt.normalizer))
    return DistillTrainer(config, LocoEnv(config.env), Teacher(*given), make_mesh())


def check_student(run: Run) -> None:
    """Refuses, before a teacher is trained, what the trainer of the policy that imitates it would refuse.

    Raises:
        UserError: if it does not fit together, the policy has no critic, or the run has lost its teacher.
    """
    from loco_mjx.networks.policies import make_networks
    from loco_mjx.ppo import checks
    from loco_mjx.run.policy import observation_shapes, parameter_shapes

    config = run.config
    networks = make_networks(config.policy, config.network, config.env.action_size)
    checks.check(config, networks, observation_shapes(config), jax.device_count())
    if "critic" not in parameter_shapes(config, networks)["params"]:
        raise UserError(
            f"policy '{config.policy}' has no privileged critic, which method distill needs; accepted: a policy whose "
            "outputs are those of loco_mjx.networks.heads"
        )
    teacher = run.directory / directory.TEACHER
    if checkpoint.newest(run.directory) and directory.find(teacher) is None:
        raise UserError(f"{run.directory} has learnt from a teacher that is not there; restore the folder {teacher}")


def teach(
    run: Run, options: loop.LoopOptions, console: Console, command: list[str], evaluators: Evaluators
) -> loop.Outcome | None:
    """Trains the teacher of a run of method `distill`, in the run's folder `teacher`, or goes on with it.

    Returns:
        How that ended where it was stopped; None when the teacher is ready.

    Raises:
        UserError: as :func:`train`.
    """
    place = run.directory / directory.TEACHER
    found = directory.find(place)
    config = teacher_of(run.config)
    if found is not None:  # it is trained for as long as was asked for when it began
        ppo = dataclasses.replace(config.ppo, total_steps=found.ppo.total_steps)
        config = dataclasses.replace(config, ppo=ppo)
        directory.reconcile(place, found, config)
        if finished(place, config):
            return None
    console.print(f"first a teacher that sees what only a simulator knows, in {place}", soft_wrap=True)
    outcome = train([Run(config, place)], options, console, command, evaluators)
    return None if outcome.signal is None else outcome


def train(
    runs: Sequence[Run],
    options: loop.LoopOptions,
    console: Console,
    command: list[str],
    evaluators: Evaluators = lambda runs, trainer: [],
    callback: Callable[[int, Mapping[str, float]], object] | None = None,
) -> loop.Outcome:
    """Trains runs that differ in seed alone, or goes on training, all in one program.

    Args:
        runs: what to train, and where; of those found in their directories only `total_steps` may differ.
        options: when to save and to evaluate.
        console: for the table and the progress.
        command: the command line, for the record.
        evaluators: from the runs and their trainer to what evaluates each of them; an empty list: they are not.
        callback: called with each iteration's samples and metrics, not those of a teacher; once it returns True, the
            runs are saved and end.

    Raises:
        UserError: if they cannot start; nothing is written then.
    """
    runs = [dataclasses.replace(run, config=needs.with_imports(run.config)) for run in runs]
    for run in runs:
        found = directory.find(run.directory)
        if found is not None:
            directory.reconcile(run.directory, found, run.config)
        check_record(run.directory / directory.INFO)
    config = runs[0].config
    collectives.check_same(json.dumps(to_dict(config)), "configuration")
    if config.method == "distill":
        check_student(runs[0])
        stopped = teach(runs[0], options, console, command, evaluators)
        if stopped is not None:
            return stopped
        collectives.on_first(lambda: None)  # whose last checkpoint is written then, for all to read
        trainer = build_student(config, runs[0].directory / directory.TEACHER)
    else:
        trainer = build(config)
    learner, parameters = group(trainer, runs), count_parameters(trainer, config)
    with contextlib.ExitStack() as claims:
        done = common_step(runs)

        def claim() -> None:
            for run in runs:
                claims.enter_context(directory.claim(run.directory))

        def record() -> None:
            for run in runs:
                directory.record_start(run.directory, run.config, provenance.describe(command) | {"samples": done})

        collectives.on_first(claim)
        seeds = [run.config.seed for run in runs]
        print_summary(console, config, provenance.devices(), parameters, seeds)
        reporter = Reporter(console, len(runs) * settings.total_samples(config), len(runs) * done, callback=callback)
        try:
            evaluations = evaluators(runs, trainer)
            return loop.run_group(learner, runs, options, reporter, evaluations, lambda: collectives.on_first(record))
        finally:
            reporter.close()


def check_record(path: Path) -> None:
    """Refuses a record of starts that another one cannot be added to.

    Raises:
        UserError: saying so.
    """
    info = directory.read_json(path) if path.exists() else {}
    if not isinstance(info, dict) or not isinstance(info.get("resumed", []), list):
        raise UserError(f"{path} does not say what the run ran with; restore it, or remove it")


def group(trainer: Any, runs: Sequence[Run]) -> GroupLearner:
    """A configuration's trainer as the learner of one run or of several."""
    if len(runs) == 1:
        return Single(trainer)
    from loco_mjx.ppo.multi_seed import SeedsTrainer

    return SeedsTrainer(trainer, [run.config.seed for run in runs])


def count_parameters(trainer: Any, config: Config) -> int:
    """Number of parameters of a trainer's networks."""
    import jax.numpy as jp

    shapes = trainer.env.observation_size
    blank = {name: jp.zeros((1, *shape)) for name, shape in shapes.items()}
    params = jax.eval_shape(lambda: trainer.networks.init(jax.random.PRNGKey(config.seed), blank))
    return sum(leaf.size for leaf in jax.tree.leaves(params))


def finished(path: Path, config: Config) -> bool:
    """Whether the run in a directory has nothing left to train: by its newest checkpoint that is whole."""
    return checkpoint.newest(path) >= settings.total_samples(config)
