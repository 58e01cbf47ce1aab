"""Obstacles that move: directions, integration, and the change of direction every 150 control steps."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jp

from loco_mjx.scene.types import OBSTACLE, Scene

REDRAW_STEPS = 150  # control steps between changes of direction
_AXIS, _DIAGONAL, _SKEW = 0.375, 0.3, (0.15, 0.45)  # m/s: speeds 0.375, 0.424 and 0.474

# The 20 velocities (x, y) in m/s: four along the axes, four diagonal, eight skew, four at rest.
DIRECTIONS: tuple[tuple[float, float], ...] = (
    ((_AXIS, 0.0), (-_AXIS, 0.0), (0.0, _AXIS), (0.0, -_AXIS))
    + tuple((sx * _DIAGONAL, sy * _DIAGONAL) for sx in (1, -1) for sy in (1, -1))
    + tuple((sx * vx, sy * vy) for vx, vy in (_SKEW, _SKEW[::-1]) for sx in (1, -1) for sy in (1, -1))
    + ((0.0, 0.0),) * 4
)


def draw_velocity(key: jax.Array, count: int) -> jax.Array:
    """(count, 2) velocities in m/s, each one of DIRECTIONS with equal chance."""
    # index = +U{0..19}
    index = jax.random.randint(key, (count,), 0, len(DIRECTIONS))
    return jp.array(DIRECTIONS, jp.float32)[index]


def move(scene: Scene, dt: float) -> Scene:
    """The scene ``dt`` seconds later: every box has gone on at its velocity.

    Args:
        scene: one environment's scene.
        dt: time, s.
    """
    boxes = scene.boxes
    shift = jp.pad(boxes.velocity * jp.float32(dt), ((0, 0), (0, 1)))
    return replace(scene, boxes=replace(boxes, center=boxes.center + shift))


def redraw(key: jax.Array, scene: Scene, step: jax.Array) -> Scene:
    """Changes the obstacles' directions if ``step`` is a positive multiple of REDRAW_STEPS.

    As in the official code, a box that moves along an axis turns back; any other draws a new direction.

    Args:
        key: random key.
        scene: one environment's scene.
        step: control step of the episode, int32 scalar.
    """
    boxes = scene.boxes
    along_axis = (boxes.velocity[:, 0] == 0.0) != (boxes.velocity[:, 1] == 0.0)
    changed = jp.where(along_axis[:, None], -boxes.velocity, draw_velocity(key, boxes.count))
    due = (step > 0) & (step % REDRAW_STEPS == 0) & (boxes.kind == OBSTACLE)
    velocity = jp.where(due[:, None], changed, boxes.velocity)
    return replace(scene, boxes=replace(boxes, velocity=velocity))
