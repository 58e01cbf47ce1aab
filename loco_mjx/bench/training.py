"""How fast the environment and training are on this machine."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jp
from jax.sharding import PartitionSpec as P

from loco_mjx import controllers
from loco_mjx.bench.timing import Rolling, seconds_in_turn, seconds_per_call
from loco_mjx.config import Config, preset
from loco_mjx.env import LocoEnv, autoreset
from loco_mjx.errors import UserError
from loco_mjx.ppo.multi_seed import SeedsTrainer
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.robots import DEFAULT
from loco_mjx.run import machine, settings
from loco_mjx.sharding import AXIS, make_mesh, shard_map

WINDOW = 32  # control steps in one call of the environment's benchmark
POOL = 64  # scenes to reset into
Result = dict[str, Any]


def bench_config(
    task: str, policy: str, num_envs: int | None, robot: str = DEFAULT, controller: str = controllers.DEFAULT
) -> Config:
    """The `fast` preset's configuration for a task, a policy, a robot and a controller.

    Raises:
        UserError: if a name is unknown or sizes do not divide.
    """
    base = preset("fast", robot, controller)
    ppo = base.ppo if num_envs is None else dataclasses.replace(base.ppo, num_envs=num_envs)
    env = dataclasses.replace(base.env, task=task)
    return settings.complete(dataclasses.replace(base, policy=policy, env=env, ppo=ppo))


def bench_env(config: Config, seconds: float) -> Result:
    """Control steps per second with random actions, depth included where the policy uses it.

    Args:
        config: what to measure.
        seconds: to measure for, at least.
    """
    env, mesh, count = LocoEnv(config.env), make_mesh(), config.ppo.num_envs
    if count % mesh.size:
        raise UserError(f"num-envs {count} does not divide over {mesh.size} devices; accepted: a multiple")
    pool = env.make_pool(jax.random.PRNGKey(0), POOL)

    def start(keys: jax.Array, pool: Any) -> Any:
        return jax.vmap(lambda key: autoreset.first(env, key, pool))(keys)

    def window(state: Any, keys: jax.Array, pool: Any) -> Any:
        def body(state: Any, t: jax.Array) -> tuple[Any, None]:
            step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
            # action = +U(-1, 1)
            draw = jax.vmap(lambda key: jax.random.uniform(key, (env.action_size,), minval=-1.0))
            return jax.vmap(lambda s, a: autoreset.step(env, s, a, pool))(state, draw(step_keys)), None

        return jax.lax.scan(body, state, jp.arange(WINDOW, dtype=jp.int32))[0]

    keys = jax.random.split(jax.random.PRNGKey(1), count)
    begin = time.monotonic()
    state = jax.block_until_ready(jax.jit(shard_map(start, mesh, (P(AXIS), P()), P(AXIS)))(keys, pool))
    step = jax.jit(shard_map(window, mesh, (P(AXIS), P(AXIS), P()), P(AXIS)), donate_argnums=0)
    state = jax.block_until_ready(step(state, keys, pool))
    compile_seconds = time.monotonic() - begin
    per_call = seconds_per_call(Rolling(lambda state: step(state, keys, pool), state), seconds)
    return {
        "per_second": count * WINDOW / per_call,
        "unit": "control steps",
        "depth": config.env.observation.depth.enabled,
        "compile_seconds": compile_seconds,
    }


def bench_train(config: Config, seconds: float) -> Result:
    """Samples per second of whole iterations, and how they divide into collecting and learning.

    Args:
        config: what to measure.
        seconds: to measure for, at least.
    """
    trainer = Trainer(config, LocoEnv(config.env), make_mesh())
    begin = time.monotonic()
    state, pool = trainer.init(), trainer.make_pool(0)
    state, _ = jax.block_until_ready(trainer.iterate(state, pool))
    compile_seconds, startup_seconds = time.monotonic() - begin, machine.process_age()
    rolling = Rolling(lambda state: trainer.iterate(state, pool)[0], state)
    iteration = seconds_per_call(rolling, seconds)
    collect = _collect_seconds(trainer, rolling.state, pool)
    return {
        "per_second": config.ppo.samples_per_iteration / iteration,
        "unit": "samples",
        "policy": config.policy,
        "compile_seconds": max(compile_seconds - iteration, 0.0),
        "startup_seconds": startup_seconds,  # from the start of the process to the end of the first iteration
        "iteration_seconds": iteration,
        "collect_seconds": collect,
        "learn_seconds": iteration - collect,
        "compilations": trainer.iterate._cache_size(),  # type: ignore[attr-defined]
    }


def bench_seeds(config: Config, seconds: float, seeds: int) -> Result:
    """Samples per second of several seeds in one program, and of one seed by itself: `single`.

    The two are measured in turn, as many iterations of the single seed as there are seeds to one of them together.

    Args:
        config: what to measure.
        seconds: to measure each of the two for, at least.
        seeds: how many train together, 1 or more.
    """
    trainer = Trainer(config, LocoEnv(config.env), make_mesh())
    samples = config.ppo.samples_per_iteration
    learners: tuple[Any, ...] = (trainer, SeedsTrainer(trainer, range(seeds)))
    counts = (samples, seeds * samples)
    started = [_started(learner) for learner in learners]
    iterations = seconds_in_turn([(started[0][0], seeds), (started[1][0], 1)], 2 * seconds)
    single, together = (
        {
            "per_second": count / iteration,
            "iteration_seconds": iteration,
            "compile_seconds": max(first - iteration, 0.0),
            "compilations": learner.iterate._cache_size(),
        }
        for learner, count, iteration, (_, first) in zip(learners, counts, iterations, started, strict=True)
    )
    ratio = together["per_second"] / single["per_second"]
    what = {"unit": "samples", "policy": config.policy, "seeds": seeds}
    return together | what | {"single": single, "times_in_a_row": ratio}


def _started(learner: Any) -> tuple[Rolling, float]:
    """A learner's further iterations, and how long it took to the end of the first."""
    begin = time.monotonic()
    state, pool = learner.init(), learner.make_pool(0)
    state, _ = jax.block_until_ready(learner.iterate(state, pool))
    return Rolling(lambda state: learner.iterate(state, pool)[0], state), time.monotonic() - begin


def _collect_seconds(trainer: Trainer, state: Any, pool: Any) -> float:
    jax.block_until_ready(trainer.collect(state, pool))
    return seconds_per_call(lambda: trainer.collect(state, pool), seconds=0.0)
