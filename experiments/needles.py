"""Depth of terrain where it is hardest: ``python -m experiments.needles``.

Level ground with needles of one vertex, seen by the depth camera and by C MuJoCo's rays. What came of it goes to
``experiments/results/cpu/needles.json``.
"""

from __future__ import annotations

import json
from typing import Any

import mujoco
import numpy as np

from experiments.committed import RESULTS

KEPT = RESULTS / "needles.json"
VIEWS, SEED = 64, 0
HEIGHT, CELL = 0.6, 0.1  # m, of a needle; of the grid
ORIGIN, SHAPE = (-2.0, -7.0), (150, 140)
CLOSE = 0.05  # m
TEXT = """## Depth of terrain, against C MuJoCo's rays

`python -m experiments.needles`: {views} views, each of level ground with 20 to 80 needles of {height:g} m ahead, one
vertex of the grid each; from 0.25 to 0.5 m above the ground, rolled, pitched and turned. Of {pixels:,} pixels
{close:.1%} are within {centimetres:g} cm of C MuJoCo's, {far:.1%} read farther, {near:.1%} nearer; in the worst view
{worst:.1%} are within.
"""


def views() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Heights (150, 140), m, and poses (7,) of the base."""
    rng, fields, poses = np.random.default_rng(SEED), [], []
    for _ in range(VIEWS):
        heights = np.zeros(SHAPE, np.float32)
        count = rng.integers(20, 81)
        # A vertex from 0.6 m ahead of the origin up to 10 m, 5 m to either side = U
        heights[rng.integers(26, 120, count), rng.integers(20, 120, count)] = HEIGHT
        roll, pitch, yaw = rng.uniform(-1.0, 1.0, 3) * [0.3, 0.3, 0.8]  # +U(-0.3, 0.3), …, +U(-0.8, 0.8) rad
        quat = np.zeros(4)
        mujoco.mju_euler2Quat(quat, (yaw, pitch, roll), "zyx")
        fields.append(heights)
        poses.append(np.array([0.0, 0.0, rng.uniform(0.25, 0.5), *quat], np.float32))  # height +U(0.25, 0.5) m
    return fields, poses


def compare() -> dict[str, Any]:
    """Shares of the pixels that are close to C's, farther and nearer."""
    import jax
    import jax.numpy as jp

    from loco_mjx.config import DepthConfig
    from loco_mjx.depth import c_mujoco
    from loco_mjx.depth.render import render
    from loco_mjx.robots import get_robot
    from loco_mjx.run import provenance
    from loco_mjx.scene.mjcf import scene_spec
    from loco_mjx.scene.parts import make_scene
    from loco_mjx.scene.types import Terrain

    robot, config = get_robot("a1"), DepthConfig()
    see = jax.jit(lambda scene, pose: render(scene, pose, robot.camera, config))
    off = []
    for heights, pose in zip(*views(), strict=True):
        scene = make_scene(ground_field=Terrain(jp.asarray(heights), ORIGIN, CELL))
        model = scene_spec(jax.tree.map(np.asarray, scene), robot).compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        off.append(np.asarray(see(scene, jp.asarray(pose))) - c_mujoco.cast(model, data, pose, robot.camera, config))
    off = np.array(off)
    close = np.abs(off) <= CLOSE
    shares = {"close": close.mean(), "far": (off > CLOSE).mean(), "near": (off < -CLOSE).mean()}
    shares["worst"] = close.mean(axis=(1, 2)).min()
    about = {"pixels": off.size, "versions": provenance.versions()}
    return {name: float(share) for name, share in shares.items()} | about


def section() -> str:
    """Of docs/results.md; nothing where there are no results."""
    if not KEPT.exists():
        return ""
    found = {name: value for name, value in json.loads(KEPT.read_text()).items() if name != "versions"}
    return TEXT.format(views=VIEWS, height=HEIGHT, centimetres=100 * CLOSE, **found)


def main() -> None:
    """Compares, and keeps what came of it."""
    KEPT.write_text(json.dumps(compare(), indent=1) + "\n")
    print(section())


if __name__ == "__main__":
    main()
