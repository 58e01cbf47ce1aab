"""What the physics tests share: an open-loop trot, scenes made by hand, and rollouts of ours and of C MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jp
import mujoco
import numpy as np

from loco_mjx import a1
from loco_mjx.physics.model import PhysicsModel, a1_xml_path
from loco_mjx.physics.step import Dynamics, Outcome, PhysicsState, control_step, initial_state
from loco_mjx.scene.types import STEP, Boxes, Cylinders, Scene, Spheres, Terrain

PERIOD = 0.4  # s
STRIDE, LIFT, HEIGHT = 0.06, 0.05, 0.25  # m: half a stride, how high a foot swings, hips over feet


def trot(time: float) -> np.ndarray:
    """Joint targets (12,) of a trot at a time, rad: diagonal pairs swing in turn."""
    targets = []
    for leg in a1.LEGS:
        phase = (time / PERIOD + (0.0 if leg in ("FR", "RL") else 0.5)) % 1.0
        swing = phase < 0.5
        along = -np.cos(2 * np.pi * phase) if swing else 1.0 - 4.0 * (phase - 0.5)
        x, down = STRIDE * along, HEIGHT - (LIFT * np.sin(2 * np.pi * phase) if swing else 0.0)
        calf = -2.0 * np.arccos(np.hypot(x, down) / (2 * a1.LINK_LENGTH))
        targets += [0.0, np.arctan2(-x, down) - 0.5 * calf, calf]
    return np.array(targets, np.float32)


def trot_targets(steps: int) -> np.ndarray:
    """(steps, 12) targets of the trot, one per control step."""
    return np.stack([trot(i * a1.CONTROL_DT) for i in range(steps)])


def scene(
    boxes: Sequence[dict] = (), cylinders: Sequence[dict] = (), terrain: Terrain | None = None
) -> Scene:
    """A scene of boxes (center, half, yaw, kind: a step unless given) and cylinders (center, radius, half_height)."""
    column = lambda items, name, default: np.array([i.get(name, default) for i in items])  # noqa: E731
    size = len(boxes)
    made = Boxes(
        center=jp.asarray(column(boxes, "center", None).reshape(size, 3), jp.float32),
        half=jp.asarray(column(boxes, "half", None).reshape(size, 3), jp.float32),
        yaw=jp.asarray(column(boxes, "yaw", 0.0), jp.float32),
        velocity=jp.zeros((size, 2)),
        kind=jp.asarray(column(boxes, "kind", STEP), jp.int32),
    )
    trees = Cylinders(
        jp.asarray(column(cylinders, "center", None).reshape(len(cylinders), 3), jp.float32),
        jp.asarray(column(cylinders, "radius", None), jp.float32),
        jp.asarray(column(cylinders, "half_height", None), jp.float32),
    )
    none = Spheres(jp.zeros((0, 3)), jp.zeros(0), jp.zeros(0, bool), jp.zeros(0, bool))
    return Scene(made, none, trees, terrain, jp.zeros(3))


def standing(x: float = 0.0, y: float = 0.0, height: float = a1.STAND_HEIGHT) -> np.ndarray:
    """(19,) configuration in the default pose."""
    return np.array([x, y, height, 1.0, 0.0, 0.0, 0.0, *a1.DEFAULT_POSE], np.float32)


def rollout(
    model: PhysicsModel, qpos: np.ndarray, world: Scene, targets: np.ndarray, dynamics: Dynamics
) -> tuple[PhysicsState, Outcome]:
    """States after each control step, and outcomes, from rest; leading axis: control steps."""

    def step(state: PhysicsState, target: jax.Array) -> tuple[PhysicsState, tuple[PhysicsState, Outcome]]:
        state, outcome = control_step(model, state, world, target, dynamics)
        return state, (state, outcome)

    run = jax.jit(lambda start, targets: jax.lax.scan(step, start, targets)[1])
    return jax.tree.map(np.asarray, run(initial_state(qpos), jp.asarray(targets, jp.float32)))


def flat_c_model() -> mujoco.MjModel:
    """The A1 over the plane z = 0 in C MuJoCo."""
    spec = mujoco.MjSpec.from_file(str(a1_xml_path()))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=2, conaffinity=1)
    return spec.compile()


def c_rollout(
    model: mujoco.MjModel, qpos: np.ndarray, targets: np.ndarray, kp: float = a1.KP, kd: float = a1.KD
) -> np.ndarray:
    """(steps, 19) configurations after each control step in C MuJoCo, its solver converged, from rest."""
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-10
    data = mujoco.MjData(model)
    data.qpos[:19] = qpos
    history = []
    for target in targets:
        for _ in range(a1.SUBSTEPS):
            torque = kp * (target - data.qpos[7:19]) - kd * data.qvel[6:18]
            data.ctrl[:] = np.clip(torque, -a1.TORQUE_LIMIT, a1.TORQUE_LIMIT)
            mujoco.mj_step(model, data)
        history.append(data.qpos[:19].copy())
    return np.array(history)
