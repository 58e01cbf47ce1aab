"""Whether a corridor full of boxes can be walked through, and boxes made smaller until it can."""

from __future__ import annotations

import jax
import jax.numpy as jp

from loco_mjx.scene.types import COLLISION_MARGIN

ROUNDS = 8  # after which what is left of a box's surplus is 1 / 256


def closing(center: jax.Array, half: jax.Array, side: float, width: float) -> jax.Array:
    """Boxes of a chain from wall to wall whose links leave less than ``width`` free: a round robot cannot pass it.

    Args:
        center: (N, 2) x and y of unturned boxes, m.
        half: (N, 2) half extents for contact, m.
        side: the corridor is free from y = −side to side, m.
        width: the robot's, m.

    Returns:
        (N,) bool, all false where there is a way.
    """
    between = jp.abs(center[:, None] - center[None]) - half[:, None] - half[None]
    linked = jp.sum(jp.maximum(between, 0.0) ** 2, axis=-1) < width**2
    y, reach = center[:, 1], side - half[:, 1]
    return _spread(linked, reach + y < width) & _spread(linked, reach - y < width)


def _spread(linked: jax.Array, start: jax.Array) -> jax.Array:
    """(N,) what is linked to the start, over however many links."""

    def onward(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        _, now = carry
        return now, now | jp.any(linked & now, axis=1)

    return jax.lax.while_loop(lambda carry: jp.any(carry[0] != carry[1]), onward, onward((start, start)))[1]


def opened(center: jax.Array, half: jax.Array, smallest: float, side: float, width: float) -> jax.Array:
    """Half extents with which a corridor is open: boxes of a chain that closes it are made smaller, step by step.

    Args:
        center: (N, 2) x and y of unturned boxes, m.
        half: (N, 2) visible half extents as drawn, m.
        smallest: half extent below which none is made, m; boxes of this size must be unable to close the corridor.
        side: the corridor is free from y = −side to side, m.
        width: what stays free, m.

    Returns:
        (N, 2) half extents, those of boxes that close nothing unchanged.
    """

    def blocked(half: jax.Array) -> jax.Array:
        return closing(center, half + COLLISION_MARGIN, side, width)

    def shrink(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        rounds, half, boxes = carry
        half = jp.where(boxes[:, None], 0.5 * (half + smallest), half)
        return rounds + 1, half, blocked(half)

    start = (jp.int32(0), half, blocked(half))
    return jax.lax.while_loop(lambda carry: (carry[0] < ROUNDS) & jp.any(carry[2]), shrink, start)[1]
