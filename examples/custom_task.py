"""A task of one's own: poles to be passed left and right by turns.

loco-mjx scene --import examples/custom_task.py --task slalom --out slalom.xml
loco-mjx train --import examples/custom_task.py --task slalom
"""

import jax
import jax.numpy as jp

import loco_mjx
from loco_mjx.scene.parts import join, make_boxes, make_scene, walls
from loco_mjx.scene.types import Scene

POLES = 36  # as many in every scene: arrays have static shapes
SPACING, SIDE, JITTER = 2.0, 0.35, 0.15  # m
HALF = (0.1, 0.1, 0.6)  # m, half extents of a pole


@loco_mjx.register_task("slalom", summary="poles to be passed left and right by turns")
def slalom(key: jax.Array) -> Scene:
    """Draws a scene: the key decides where the poles stand, to within JITTER."""
    number = jp.arange(POLES)
    x = 2.5 + SPACING * number
    y = SIDE * (-1.0) ** number
    moved = jax.random.uniform(key, (POLES, 2), minval=-JITTER, maxval=JITTER)
    center = jp.stack([x + moved[:, 0], y + moved[:, 1], jp.full(POLES, HALF[2])], axis=1)
    return make_scene(join(make_boxes(center, jp.array(HALF)), walls(y=2.0, half_thickness=0.1, height=2.0)))
