"""How the deterministic policy of a run does while it trains: on its own task, and on others where asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from loco_mjx.env import LocoEnv
from loco_mjx.evaluation.episodes import Evaluator, evaluation_config, means
from loco_mjx.run.run_log import Run
from loco_mjx.run.schedule import Evaluate, LoopOptions

SEED = 1_000_000  # added to the run's seed: the same scenes at every evaluation of a run


def evaluators(options: LoopOptions, tasks: Sequence[str] = ()) -> Callable[[Sequence[Run], Any], list[Evaluate]]:
    """Makes, from runs and their trainer, the functions that the loop calls to evaluate each run.

    Metrics of the run's own task keep their names, those of another begin with it: `wide/distance`.

    Args:
        options: how often (never: there are none), and over how many episodes.
        tasks: evaluated on besides the one that is trained on.
    """

    def make(runs: Sequence[Run], trainer: Any) -> list[Evaluate]:
        if not options.evaluations:
            return []
        own = runs[0].config.env
        configs = {task: evaluation_config(own, task) for task in dict.fromkeys((own.task, *tasks))}
        programs = {
            "" if task == own.task else f"{task}/": Evaluator(LocoEnv(env), trainer.networks, env.horizon, trainer.mesh)
            for task, env in configs.items()
        }

        def evaluate(seed: int, state: Any) -> dict[str, float]:
            found: dict[str, float] = {}
            for prefix, program in programs.items():
                figures = program.run(state.policy, state.normalizer, seed, options.evaluation_episodes)
                found |= {prefix + name: value for name, value in means(figures).items()}
            return found

        return [partial(evaluate, (run.config.seed + SEED) % 2**31) for run in runs]

    return make
