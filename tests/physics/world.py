"""What the physics tests share: scenes made by hand, an open-loop trot, and rollouts of ours and of C MuJoCo."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jp
import mujoco
import numpy as np

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.model import PhysicsModel, build
from loco_mjx.physics.step import Dynamics, PhysicsState, SubstepTrace, control_step, initial_state, nominal_dynamics
from loco_mjx.robots import LEGS, Robot
from loco_mjx.scene.types import STEP, Boxes, Cylinders, Scene, Spheres, Terrain
from tests.known_robots import A1

BATCH = 4  # environments in every rollout, so that the tests share one compiled program
BOXES, TREES = 9, 1  # likewise
AWAY = (500.0, 500.0, 0.0)
USERS = PhysicsConfig()
CONVERGED = PhysicsConfig(iterations=20, ls_iterations=12, more_iterations=0)  # always enough

PERIOD = 0.4  # s
STRIDE, LIFT, HEIGHT = 0.06, 0.05, 0.25  # m: half a stride, how high a foot swings, hips over feet
GAIT_KP, GAIT_KD = 80.0, 1.0


def trot(time: float, robot: Robot = A1) -> np.ndarray:
    """Joint targets (12,) of a trot at a time, rad: diagonal pairs swing in turn."""
    targets = []
    for leg in LEGS:
        phase = (time / PERIOD + (0.0 if leg in ("FR", "RL") else 0.5)) % 1.0
        swing = phase < 0.5
        along = -np.cos(2 * np.pi * phase) if swing else 1.0 - 4.0 * (phase - 0.5)
        x, down = STRIDE * along, HEIGHT - (LIFT * np.sin(2 * np.pi * phase) if swing else 0.0)
        calf = -2.0 * np.arccos(np.hypot(x, down) / (2 * robot.thigh_length))
        targets += [0.0, np.arctan2(-x, down) - 0.5 * calf, calf]
    return np.array(targets, np.float32)


def trot_targets(steps: int, robot: Robot = A1) -> np.ndarray:
    """(steps, 12) targets of the trot, one per control step."""
    return np.stack([trot(i * robot.control_dt, robot) for i in range(steps)])


def still(steps: int) -> np.ndarray:
    """(steps, 12) targets of standing."""
    return np.tile(np.array(A1.default_pose, np.float32), (steps, 1))


def scene(boxes: Sequence[dict] = (), trees: Sequence[dict] = (), terrain: Terrain | None = None) -> Scene:
    """A scene of boxes (center, half, yaw, kind: a step unless given) and trees (center, radius, half_height).

    It is filled up to BOXES and TREES with some that are far away.
    """
    boxes = [*boxes, *[{"center": AWAY, "half": (0.1, 0.1, 0.1)}] * (BOXES - len(boxes))]
    trees = [*trees, *[{"center": AWAY, "radius": 0.1, "half_height": 0.1}] * (TREES - len(trees))]
    fill = lambda items, name, default=None: np.array([i.get(name, default) for i in items])  # noqa: E731
    made = Boxes(
        center=jp.asarray(fill(boxes, "center"), jp.float32),
        half=jp.asarray(fill(boxes, "half"), jp.float32),
        yaw=jp.asarray(fill(boxes, "yaw", 0.0), jp.float32),
        velocity=jp.zeros((len(boxes), 2)),
        kind=jp.asarray(fill(boxes, "kind", STEP), jp.int32),
    )
    cylinders = Cylinders(
        jp.asarray(fill(trees, "center"), jp.float32),
        jp.asarray(fill(trees, "radius"), jp.float32),
        jp.asarray(fill(trees, "half_height"), jp.float32),
    )
    none = Spheres(jp.zeros((0, 3)), jp.zeros(0), jp.zeros(0, bool), jp.zeros(0, bool))
    return Scene(made, none, cylinders, terrain, jp.zeros(3))


def standing(x: float = 0.0, y: float = 0.0, height: float = A1.stand_height) -> np.ndarray:
    """(19,) configuration in the default pose."""
    return np.array([x, y, height, 1.0, 0.0, 0.0, 0.0, *A1.default_pose], np.float32)


@functools.cache
def physics(config: PhysicsConfig = USERS) -> PhysicsModel:
    """The physics, as users have it unless told otherwise."""
    return build(A1, config)


@functools.cache
def stepper(config: PhysicsConfig = USERS) -> Callable[..., tuple[PhysicsState, SubstepTrace]]:
    """control_step of BATCH environments, compiled."""
    model = physics(config)
    return jax.jit(jax.vmap(lambda *args: control_step(model, *args)))


def nominal(friction: float = 1.0) -> Dynamics:
    """The A1 under its own gains."""
    return nominal_dynamics(A1.kp, A1.kd, friction)


def batch(items: Sequence[Any]) -> Any:
    """Pytrees stacked, the last repeated up to BATCH."""
    items = [*items, *[items[-1]] * (BATCH - len(items))]
    return jax.tree.map(lambda *leaves: jp.stack(leaves), *items)


def rollout(
    starts: Sequence[np.ndarray | PhysicsState],
    worlds: Sequence[Scene],
    targets: np.ndarray,
    dynamics: Sequence[Dynamics] | None = None,
    config: PhysicsConfig = USERS,
) -> tuple[PhysicsState, SubstepTrace]:
    """States after each control step and outcomes, leading axes (environments, steps), of up to BATCH environments.

    Args:
        starts: configurations at rest, or states.
        worlds: their scenes.
        targets: (steps, 12), or (environments, steps, 12).
        dynamics: of each; nominal if None.
        config: of the physics.
    """
    state = batch([start if isinstance(start, PhysicsState) else initial_state(start) for start in starts])
    world, how = batch(worlds), batch(dynamics or [nominal()])
    spread = targets if targets.ndim == 3 else targets[None]
    wide = np.concatenate([spread, *[spread[-1:]] * (BATCH - spread.shape[0])])
    states, outcomes = [], []
    for t in range(wide.shape[1]):
        state, outcome = stepper(config)(state, world, jp.asarray(wide[:, t], jp.float32), how)
        states.append(state)
        outcomes.append(outcome)
    return jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *states), jax.tree.map(
        lambda *leaves: np.stack(leaves, axis=1), *outcomes
    )


def flat_c_model(robot: Robot = A1) -> mujoco.MjModel:
    """A robot over the plane z = 0 in C MuJoCo."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=2, conaffinity=1)
    return spec.compile()


def c_rollout(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    targets: np.ndarray,
    kp: float = A1.kp,
    kd: float = A1.kd,
    qvel: np.ndarray | float = 0.0,
    step: Callable[[mujoco.MjData], object] | None = None,
) -> np.ndarray:
    """(steps, 19) configurations after each control step in C MuJoCo, its solver converged; `step` for `mj_step`."""
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-10
    data = mujoco.MjData(model)
    data.qpos[:19], data.qvel[:18] = qpos, qvel
    history = []
    for target in targets:
        for _ in range(A1.substeps):
            torque = kp * (target - data.qpos[7:19]) - kd * data.qvel[6:18]
            data.ctrl[:] = np.clip(torque, *model.actuator_ctrlrange.T)
            mujoco.mj_step(model, data) if step is None else step(data)
        history.append(data.qpos[:19].copy())
    return np.array(history)
