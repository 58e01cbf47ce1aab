"""How many physics steps a second this machine makes, beside C MuJoCo's rollout of the same scenes."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import mujoco
import mujoco.rollout
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.bench.timing import Rolling, seconds_per_call
from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.model import PhysicsModel, build
from loco_mjx.physics.step import PhysicsState, control_step, initial_state, nominal_dynamics
from loco_mjx.robots import DEFAULT, NJOINT, Robot, get_robot
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.pool import make_pool
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import get_task
from loco_mjx.scene.types import Scene
from loco_mjx.sharding import AXIS, dividing_devices, make_mesh, shard_map

WINDOW = 10  # control steps in a call
PEER_SCENES = 8  # per thread
WIGGLE = 0.3  # rad, of random targets about the default pose


def _standing(robot: Robot, scene: Scene) -> PhysicsState:
    """At rest in the default pose at the origin."""
    zero = jp.zeros((), jp.float32)
    height = ground_height(scene, zero, zero) + robot.stand_height
    start = jp.concatenate([jp.zeros(2), height[None], jp.array([1.0, 0.0, 0.0, 0.0]), jp.array(robot.default_pose)])
    return initial_state(start)


def _window(model: PhysicsModel, state: PhysicsState, scene: Scene, key: jax.Array) -> tuple[PhysicsState, jax.Array]:
    """WINDOW control steps of one environment toward random targets, and the next key."""
    robot = model.robot

    def body(carry: tuple[PhysicsState, jax.Array], _: None) -> tuple[tuple[PhysicsState, jax.Array], None]:
        state, key = carry
        key, key_target = jax.random.split(key)
        # target = default pose + U(-0.3, 0.3)
        wiggle = jax.random.uniform(key_target, (NJOINT,), minval=-WIGGLE, maxval=WIGGLE)
        target, how = jp.array(robot.default_pose) + wiggle, nominal_dynamics(robot.kp, robot.kd)
        return (control_step(model, state, scene, target, how)[0], key), None

    return jax.lax.scan(body, (state, key), None, length=WINDOW)[0]


def bench_physics(
    task: str, num_envs: int, seconds: float, config: PhysicsConfig | None = None, robot: str = DEFAULT
) -> dict[str, Any]:
    """Physics steps per second over all local devices, and C MuJoCo's with as many threads.

    Args:
        task: whose scenes.
        num_envs: environments; split over as many devices as divide them.
        seconds: to measure for, at least; once for each of the two.
        config: solver settings; the defaults if None.
        robot: which one, by name or path.

    Returns:
        per_second, unit, compile_seconds, num_envs, devices, and peer: name, per_second and threads.

    Raises:
        UnknownNameError: if there is no such task or robot.
    """
    devices = dividing_devices(num_envs)
    key_scenes, key_targets = jax.random.split(jax.random.PRNGKey(0))
    scenes = make_pool(key_scenes, get_task(task), num_envs)
    model = build(get_robot(robot), config or PhysicsConfig(), get_task(task).obstacle_slots)

    mesh = make_mesh(devices)
    keys = jax.random.split(key_targets, num_envs)
    states, scenes, keys = jax.device_put(
        (jax.vmap(partial(_standing, model.robot))(scenes), scenes, keys), NamedSharding(mesh, P(AXIS))
    )
    many = jax.vmap(lambda state, scene, key: _window(model, state, scene, key))
    shared = jax.jit(shard_map(many, mesh, P(AXIS), P(AXIS)))
    begin = time.monotonic()
    compiled = shared.lower(states, scenes, keys).compile()
    compile_seconds = time.monotonic() - begin
    window = Rolling(lambda carry: compiled(carry[0], scenes, carry[1]), (states, keys))
    jax.block_until_ready(window())
    per_call = seconds_per_call(window, seconds)
    return {
        "per_second": num_envs * WINDOW * model.robot.substeps / per_call,
        "unit": "physics steps",
        "compile_seconds": compile_seconds,
        "num_envs": num_envs,
        "devices": len(devices),
        "peer": _peer(model.robot, scenes, len(devices), seconds),
    }


def with_motor_law(robot: Robot, model: mujoco.MjModel) -> mujoco.MjModel:
    """Makes a compiled robot's motors PD controllers with the nominal gains, whose controls are joint targets."""
    model.actuator_gainprm[:, 0] = robot.kp
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -robot.kp, -robot.kd
    model.actuator_ctrllimited[:] = False
    model.actuator_forcelimited[:] = True
    model.actuator_forcerange[:] = np.outer(robot.torque_limit, [-1.0, 1.0])
    return model


def _peer(robot: Robot, scenes: Scene, threads: int, seconds: float) -> dict[str, Any]:
    """The same measure of mujoco.rollout on the full scenes, with the same kind of targets."""
    count = min(PEER_SCENES * threads, scenes.goal.shape[0])
    specs = [scene_spec(jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), scenes), robot) for i in range(count)]
    models = [with_motor_law(robot, spec.compile()) for spec in specs]
    data = [mujoco.MjData(model) for model in models]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.zeros((count, mujoco.mj_stateSize(models[0], full)))
    for model, one, state in zip(models, data, states, strict=True):
        mujoco.mj_resetDataKeyframe(model, one, model.key("home").id)
        mujoco.mj_getState(model, one, state, full)
    # target = default pose + U(-0.3, 0.3)
    wiggle = np.random.default_rng(0).uniform(-WIGGLE, WIGGLE, (count, WINDOW, NJOINT))
    targets = np.repeat(np.array(robot.default_pose) + wiggle, robot.substeps, axis=1)
    with mujoco.rollout.Rollout(nthread=threads) as rollout:
        begin, calls = time.monotonic(), 0
        while calls < 2 or time.monotonic() - begin < seconds:
            history, _ = rollout.rollout(models, data[:threads], states, control=targets)
            states = history[:, -1]
            calls += 1
    steps = calls * count * WINDOW * robot.substeps
    return {"name": "mujoco.rollout", "per_second": steps / (time.monotonic() - begin), "threads": threads}
