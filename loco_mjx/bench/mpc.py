"""How many ticks of the whole-body controller a second this machine computes, beside OSQP and quadprog."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.bench.timing import seconds_in_turn
from loco_mjx.controllers import TICK
from loco_mjx.robots import DEFAULT, get_robot
from loco_mjx.sharding import AXIS, dividing_devices, make_mesh, shard_map
from loco_mjx.whole_body import controller, gait, library, mpc, solver
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import Body, body_of

PEER_PROGRAMS = 64  # in a call
EPS = 1e-4  # of OSQP: its forces are then within 0.3 N


def ticks(config: WholeBodyConfig, body: Body, pose: tuple[float, ...], count: int) -> tuple[Any, np.ndarray, Any]:
    """States, commands and measurements of robots in the middle of a walk, the first axis over `count` of them."""
    random = np.random.default_rng(0)
    one = controller.begin(config, body, np.array(pose))
    state = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], count, axis=0), one)
    state = state._replace(tick=random.integers(0, 250, count).astype(np.int32))
    # roll, pitch = N(0, 0.04), angles = pose + N(0, 0.1), speeds = N(0, 0.15), rates = N(0, 0.3)
    quat = np.concatenate([np.ones((count, 1)), random.normal(0, 0.02, (count, 2)), np.zeros((count, 1))], axis=1)
    angles = np.array(pose) + random.normal(0, 0.1, (count, 12))
    contacts = ~gait.phase(config.gait, state.tick * TICK).swings
    rates, speeds = random.normal(0, 0.3, (count, 3)), random.normal(0, 0.15, (count, 3))
    commands = random.uniform([-0.4, -0.3], [0.4, 0.3], (count, 2))
    return state, commands, controller.Measured(quat, rates, speeds, angles, contacts)


def bench_mpc(num_envs: int, seconds: float, robot: str = DEFAULT) -> dict[str, Any]:
    """Ticks per second over all local devices; and programs per second of one core, ours and libraries', in turn.

    Args:
        num_envs: robots; split over as many devices as divide them.
        seconds: to measure for, at least.
        robot: which one, by name or path.

    Returns:
        per_second, unit, compile_seconds, num_envs, devices, unsolved, microseconds (per tick and core: of all of it
        and of its program), and peers: for each library its microseconds per program and how many times ours that is.

    Raises:
        UnknownNameError: if there is no such robot.
        UserError: if quadprog is missing.
    """
    config, about = WholeBodyConfig(), get_robot(robot)
    body, devices = body_of(about), dividing_devices(num_envs)
    given = ticks(config, body, about.default_pose, num_envs)
    programs = [program(config, body, jax.tree.map(lambda x, i=i: x[i], given)) for i in range(num_envs)]
    solve = solver.make_solver(config.mpc)
    begin = time.monotonic()
    tick = _compiled(devices, lambda *args: controller.tick(config, body, solve, *args), given)
    alone = _compiled(devices, lambda *program: solve(mpc.Problem(*program)), jax.tree.map(_stack, *programs))
    compile_seconds = time.monotonic() - begin
    peers = {name: _all(one, programs[:PEER_PROGRAMS]) for name, one in solvers(config).items()}
    calls = [(tick, 1), (alone, 1), *((call, 1) for call in peers.values())]
    whole, part, *others = seconds_in_turn(calls, seconds)
    each = 1e6 * len(devices) / num_envs
    some = 1e6 / min(PEER_PROGRAMS, num_envs)
    return {
        "per_second": num_envs / whole,
        "unit": "control ticks",
        "compile_seconds": compile_seconds,
        "num_envs": num_envs,
        "devices": len(devices),
        "unsolved": int(jp.sum(tick()[2].unsolved)),
        "microseconds": {"tick": each * whole, "program": each * part},
        "peers": {
            name: {"microseconds": some * other, "times_ours": some * other / (each * part)}
            for name, other in zip(peers, others, strict=True)
        },
    }


def _stack(*items: Any) -> np.ndarray:
    return np.stack(items)


def _compiled(devices: list[Any], one: Callable[..., Any], given: Any) -> Callable[[], Any]:
    """The function of one robot on all of them, over the devices."""
    kind = lambda x: np.float32 if x.dtype == np.float64 else x.dtype  # noqa: E731
    mesh = make_mesh(devices)
    given = jax.tree.map(lambda x: jp.asarray(x, kind(x)), given)
    given = jax.device_put(given, NamedSharding(mesh, P(AXIS)))
    compiled = jax.jit(shard_map(jax.vmap(one), mesh, P(AXIS), P(AXIS))).lower(*given).compile()
    return lambda: compiled(*given)


def program(config: WholeBodyConfig, body: Body, given: tuple[Any, np.ndarray, Any]) -> mpc.Problem:
    """What one tick has a solver solve, in NumPy."""
    found: list[mpc.Problem] = []

    def keep(program: mpc.Problem) -> controller.Solution:
        found.append(program)
        return controller.Solution(np.zeros((config.mpc.horizon, 4, 3)), np.bool_(True), np.int32(0))

    controller.tick(config, body, keep, *given)
    return found[0]


def _all(solve: Callable[[library.Dense], Any], programs: list[mpc.Problem]) -> Callable[[], None]:
    """All programs solved one after the other; their matrices are made beforehand."""
    dense = [library.dense(WholeBodyConfig().mpc, program) for program in programs]

    def call() -> None:
        for one in dense:
            solve(one)

    return call


def solvers(config: WholeBodyConfig) -> dict[str, Callable[[library.Dense], Any]]:
    """The libraries that are there; each runs on one core."""
    library.make_solver(config.mpc)  # says what is missing
    from quadprog import solve_qp

    found: dict[str, Callable[[library.Dense], Any]] = {
        "quadprog": lambda one: solve_qp(one.P, -one.q, -one.A.T, -one.b),
    }
    if importlib.util.find_spec("osqp") and importlib.util.find_spec("scipy"):
        found["osqp"] = _osqp
    return found


def _osqp(one: library.Dense) -> Any:
    import osqp
    from scipy import sparse

    program = osqp.OSQP()
    low = np.full(len(one.b), -np.inf)
    matrices = sparse.csc_matrix(np.triu(one.P)), one.q, sparse.csc_matrix(one.A), low, one.b
    program.setup(*matrices, verbose=False, eps_abs=EPS, eps_rel=EPS, max_iter=10_000)
    return program.solve()
