"""How many depth frames a second this machine renders, beside C MuJoCo's ray casting of the same scenes."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import mujoco
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.bench.timing import seconds_per_call
from loco_mjx.config import DepthConfig
from loco_mjx.depth import c_mujoco
from loco_mjx.depth.render import render
from loco_mjx.robots import DEFAULT, Robot, get_robot
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.pool import make_pool
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import get_task
from loco_mjx.scene.types import Scene
from loco_mjx.sharding import AXIS, dividing_devices, make_mesh, shard_map

COURSE = 20.0  # m, of tasks without a goal
PEER_SCENES = 4  # per thread


def standing_poses(robot: Robot, key: jax.Array, scenes: Scene) -> jax.Array:
    """(N, 7) base poses of robots that stand along the course of N scenes, looking along it."""

    def one(key: jax.Array, scene: Scene) -> jax.Array:
        key_along, key_across = jax.random.split(key)
        along = jax.random.uniform(key_along, maxval=0.9)  # share of the course = +U(0, 0.9)
        end = jp.where(jp.any(scene.goal != 0.0), scene.goal[:2], jp.array([COURSE, 0.0]))
        across = jax.random.uniform(key_across, minval=-1.0)  # y = +U(-1, 1) m beside the course
        x, y = along * end[0], along * end[1] + across
        z = ground_height(scene, x, y) + robot.stand_height
        return jp.stack([x, y, z, *jp.array([1.0, 0.0, 0.0, 0.0])])

    return jax.vmap(one)(jax.random.split(key, scenes.goal.shape[0]), scenes)


def bench_depth(task: str, num_envs: int, seconds: float, robot: str = DEFAULT) -> dict[str, Any]:
    """Frames per second over all local devices, and C MuJoCo's with as many threads.

    Args:
        task: whose scenes.
        num_envs: frames rendered at once; split over as many devices as divide it.
        seconds: to measure for, at least; once for each of the two.
        robot: whose camera, by name or path.

    Returns:
        per_second, unit, compile_seconds, num_envs, devices, and peer: name, per_second and threads.

    Raises:
        UnknownNameError: if there is no such task or robot.
    """
    body = get_robot(robot)
    devices = dividing_devices(num_envs)
    key_scenes, key_poses = jax.random.split(jax.random.PRNGKey(0))
    scenes = make_pool(key_scenes, get_task(task), num_envs)
    poses = jax.jit(partial(standing_poses, body))(key_poses, scenes)

    mesh = make_mesh(devices)
    inputs = jax.device_put((scenes, poses), NamedSharding(mesh, P(AXIS)))
    many = jax.vmap(partial(render, mount=body.camera, config=DepthConfig()))
    shared = jax.jit(shard_map(many, mesh, P(AXIS), P(AXIS)))
    begin = time.monotonic()
    compiled = shared.lower(*inputs).compile()
    compile_seconds = time.monotonic() - begin
    jax.block_until_ready(compiled(*inputs))
    per_call = seconds_per_call(lambda: compiled(*inputs), seconds)
    return {
        "per_second": num_envs / per_call,
        "unit": "frames",
        "compile_seconds": compile_seconds,
        "num_envs": num_envs,
        "devices": len(devices),
        "peer": _peer(body, scenes, poses, len(devices), seconds),
    }


def _peer(robot: Robot, scenes: Scene, poses: jax.Array, threads: int, seconds: float) -> dict[str, Any]:
    """The same measure of mj_multiRay on the full scenes; it lets go of Python's lock while it runs."""
    count = min(PEER_SCENES * threads, poses.shape[0])
    worlds = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), scenes) for i in range(count)]
    models = [scene_spec(world, robot).compile() for world in worlds]
    states = [mujoco.MjData(model) for model in models]
    for model, state in zip(models, states, strict=True):
        mujoco.mj_forward(model, state)
    views = list(zip(models, states, np.asarray(poses[:count]), strict=True))

    def work(thread: int) -> int:
        frames = 0
        while frames == 0 or time.monotonic() - begin < seconds:
            model, state, pose = views[(thread + frames * threads) % count]
            c_mujoco.cast(model, state, pose, robot.camera, DepthConfig())
            frames += 1
        return frames

    begin = time.monotonic()
    with ThreadPoolExecutor(threads) as pool:
        frames = sum(pool.map(work, range(threads)))
    return {"name": "mj_multiRay", "per_second": frames / (time.monotonic() - begin), "threads": threads}
