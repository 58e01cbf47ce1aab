"""What the robot senses: proprioception with latency, its history, and the stack of depth frames."""

from __future__ import annotations

import jax
import jax.numpy as jp

from loco_mjx import rotations, sensors
from loco_mjx.config import ObservationConfig
from loco_mjx.env import privileged
from loco_mjx.physics.step import SubstepTrace
from loco_mjx.robots import Robot
from loco_mjx.sensors import Readings


def shapes(config: ObservationConfig) -> dict[str, tuple[int, ...]]:
    """The shape of each part of the observation."""
    depth = config.depth
    parts: dict[str, tuple[int, ...]] = {"state": (config.state_size,)}
    if depth.enabled:
        parts["pixels/depth"] = (depth.height, depth.width, depth.frames)
    if config.privileged:
        parts["privileged"] = (privileged.SIZE,)
    return parts


def delayed(trace: jax.Array, latency: jax.Array, timestep: float) -> jax.Array:
    """The value of a (substeps + 1, n) trace `latency` seconds before its end, between physics steps linearly."""
    last = trace.shape[0] - 1
    place = jp.clip(last - latency / timestep, 0.0, last)
    below = jp.floor(place).astype(jp.int32)
    part = place - below
    return (1 - part) * trace[below] + part * trace[jp.minimum(below + 1, last)]


def sense(
    trace: SubstepTrace,
    latency: jax.Array,
    timestep: float,
    last_action: jax.Array,
    displacement: jax.Array,
    velocity: jax.Array,
) -> Readings:
    """What the sensors are made of after a control step; what physics traces, with the latency."""
    quat = delayed(trace.quat, latency, timestep)
    return Readings(
        quat=quat / jp.maximum(jp.linalg.norm(quat), 1e-6),
        gyro=delayed(trace.gyro, latency, timestep),
        angles=delayed(trace.angles, latency, timestep),
        last_action=last_action,
        displacement=displacement,
        velocity=velocity,
    )


def first_history(config: ObservationConfig, robot: Robot) -> dict[str, jax.Array]:
    """The history at a reset: `state_frames` copies of the standing robot's sensors, each (frames, size)."""
    still, pose = jp.zeros(3), jp.array(robot.default_pose)
    standing = Readings(jp.array([1.0, 0.0, 0.0, 0.0]), still, pose, jp.zeros_like(pose), still, still)
    now = sensors.measure(standing, sensors.in_use(config), jp)
    return {name: jp.tile(value, (config.state_frames, 1)) for name, value in now.items()}


def push(history: dict[str, jax.Array], readings: Readings) -> dict[str, jax.Array]:
    """Puts the newest frame in front and drops the oldest."""
    now = sensors.measure(readings, history, jp)
    return {name: jp.concatenate([now[name][None], past[:-1]]) for name, past in history.items()}


def state_vector(history: dict[str, jax.Array], goal: jax.Array | None) -> jax.Array:
    """The `state` vector: grouped by sensor, newest frame first within each; the goal at its end where there is one."""
    parts = [history[name].reshape(-1) for name in sensors.SENSORS if name in history]
    return jp.concatenate(parts if goal is None else [*parts, goal])


def goal_in_base(goal: jax.Array, qpos: jax.Array) -> jax.Array:
    """(3,) vector from the base to the goal, m, turned into the base's heading (yaw only)."""
    yaw = rotations.yaw(qpos[3:7], jp)
    dx, dy, dz = goal - qpos[:3]
    return jp.stack([jp.cos(yaw) * dx + jp.sin(yaw) * dy, -jp.sin(yaw) * dx + jp.cos(yaw) * dy, dz])


def push_frame(stack: jax.Array, frame: jax.Array, first: jax.Array) -> jax.Array:
    """Puts the newest (H, W) frame in front of an (H, W, frames) stack; at an episode's first step fills it."""
    newest = frame[..., None]
    shifted = jp.concatenate([newest, stack[..., :-1]], axis=-1)
    return jp.where(first, newest, shifted)
