"""Does the whole-body controller walk? ``python -m experiments.whole_body [PART ...]``, parts flat, c, blocks, push.

Results go to ``experiments/results/cpu/whole_body/PART.json``: commands tracked on flat ground in MJX (flat) and in
C MuJoCo (c) over friction and mass, uneven ground in MJX (blocks), a sideways push in C MuJoCo (push).
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jp
import mujoco
import numpy as np

from loco_mjx.config import PhysicsConfig
from loco_mjx.controllers import TICK
from loco_mjx.physics.driven import driven_steps
from loco_mjx.physics.model import build
from loco_mjx.physics.step import initial_state, nominal_dynamics
from loco_mjx.robots import LEGS, Robot, get_robot
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.pool import make_pool
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import get_task
from loco_mjx.whole_body import controller, library, walk
from loco_mjx.whole_body.arrays import rotation
from loco_mjx.whole_body.config import WholeBodyConfig
from loco_mjx.whole_body.legs import body_of

RESULTS = Path(__file__).parent / "results" / "cpu" / "whole_body"
COMMANDS = tuple(itertools.product((-0.4, 0.0, 0.4), (-0.3, 0.0, 0.3)))  # m/s, rad/s
FRICTIONS, MASSES = (0.5, 0.75, 1.0, 1.25), (0.8, 1.0, 1.2)
SECONDS, SETTLED = 20.0, 1.0  # s walked, and s from which on speeds are looked at
TICKS, SUBSTEPS = 10, 2  # in a step: 0.05 s
STEP = TICKS * TICK
EPISODES = 64  # on uneven ground
PUSH, PUSHED = 60.0, 0.1  # N, s
TRACKED = 0.05  # m/s and rad/s


def nowhere() -> Any:
    """A scene of flat ground and nothing else that is near."""
    scene = jax.tree.map(lambda x: x[0], make_pool(jax.random.PRNGKey(0), get_task("thin"), 1))
    away = scene.boxes.replace(center=scene.boxes.center.at[:, 2].add(-100.0))
    return scene.replace(boxes=away)


def standing(robot: Robot, height: float = 0.0) -> np.ndarray:
    """(19,) configuration in the default pose."""
    return np.array([0.0, 0.0, height + robot.stand_height, 1.0, 0.0, 0.0, 0.0, *robot.default_pose], np.float32)


def errors(poses: np.ndarray, command: tuple[float, float]) -> dict[str, float]:
    """Mean speed ahead and yaw rate from poses (T, 7) every STEP, and how far each is from its command."""
    turned = np.stack([rotation(quat) for quat in poses[:, 3:7].astype(np.float64)])
    yaw = np.unwrap(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))
    change, middle = np.diff(poses[:, :2], axis=0) / STEP, 0.5 * (yaw[1:] + yaw[:-1])
    ahead = change[:, 0] * np.cos(middle) + change[:, 1] * np.sin(middle)
    first = round(SETTLED / STEP)
    speed, rate = float(ahead[first:].mean()), float((yaw[-1] - yaw[first]) / (STEP * (len(yaw) - 1 - first)))
    return {"speed": speed, "yaw_rate": rate, "off": abs(speed - command[0]), "yaw_off": abs(rate - command[1])}


def fell(poses: np.ndarray, ground: np.ndarray | float = 0.0) -> np.ndarray:
    """Whether each pose (..., 7) is one that ends an episode."""
    up = 1 - 2 * (poses[..., 4] ** 2 + poses[..., 5] ** 2)
    return (up < 0.6) | (poses[..., 2] - ground < 0.15)


def walk_mjx(robot: Robot, scenes: Any, starts: np.ndarray, commands: np.ndarray, dynamics: Any) -> tuple[Any, Any]:
    """Poses (T + 1, N, 7), unsolved programs (N,) of N robots walking for SECONDS; scenes one or one each."""
    config, body = WholeBodyConfig(), body_of(robot)
    model, control = build(robot, PhysicsConfig()), walk.make_controller(config, body)
    many = jax.tree.leaves(scenes)[0].ndim > jax.tree.leaves(nowhere())[0].ndim

    def begin(qpos: jax.Array, command: jax.Array) -> Any:
        return walk.commanded(walk.start(config, body, initial_state(qpos)), command)

    def step(driven: Any, scene: Any, how: Any) -> Any:
        driven, _, facts = driven_steps(model, control, driven, scene, how, TICKS, SUBSTEPS)
        return driven, (driven.physics.qpos[:7], jp.sum(facts.unsolved))

    driven = jax.vmap(begin)(jp.asarray(starts), jp.asarray(commands, jp.float32))
    compiled = jax.jit(jax.vmap(step, in_axes=(0, 0 if many else None, 0)))
    poses, unsolved = [np.asarray(starts[:, :7])], np.zeros(len(starts), int)
    for _ in range(round(SECONDS / STEP)):
        driven, (pose, failed) = compiled(driven, scenes, dynamics)
        poses.append(np.asarray(pose))
        unsolved += np.asarray(failed)
    return np.stack(poses), unsolved


def flat(robot: Robot) -> dict[str, Any]:
    """Commands tracked in MJX."""
    cases = list(itertools.product(COMMANDS, FRICTIONS, MASSES))
    one = nominal_dynamics(robot.kp, robot.kd)
    dynamics = jax.tree.map(lambda x: jp.broadcast_to(x, (len(cases), *x.shape)), one)
    mass = jp.array([case[2] for case in cases], jp.float32)
    dynamics = dynamics.replace(friction=jp.array([case[1] for case in cases], jp.float32), mass=mass, inertia=mass)
    starts = np.tile(standing(robot), (len(cases), 1))
    poses, unsolved = walk_mjx(robot, nowhere(), starts, np.array([case[0] for case in cases]), dynamics)
    rows = [
        {"command": command, "friction": friction, "mass": mass, "fell": bool(fell(poses[:, i]).any())}
        | {"unsolved": int(unsolved[i])}
        | errors(poses[:, i], command)
        for i, (command, friction, mass) in enumerate(cases)
    ]
    return tracked(rows)


def tracked(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Cases, and the worst of them."""
    return {
        "seconds": SECONDS,
        "cases": len(rows),
        "fell": sum(row["fell"] for row in rows),
        "within": sum(not row["fell"] and max(row["off"], row["yaw_off"]) <= TRACKED for row in rows),
        "worst_speed": max(row["off"] for row in rows),
        "worst_yaw_rate": max(row["yaw_off"] for row in rows),
        "unsolved": sum(row["unsolved"] for row in rows),
        "rows": rows,
    }


class Walker:
    """A robot in C MuJoCo under the controller of NumPy and quadprog; perfect sensors."""

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, self.data, model.key("home").id)
        mujoco.mj_forward(model, self.data)
        self._config, self._body = WholeBodyConfig(), body_of(robot)
        self._solve = library.make_solver(self._config.mpc)
        self._feet = [model.geom(f"{leg}_foot_sphere").id for leg in LEGS]
        self._state = controller.begin(self._config, self._body, self.data.qpos[7:].copy())
        self.unsolved, self.fell = 0, False

    def tick(self, command: np.ndarray) -> None:
        """One tick, and the physics steps under its command."""
        data, touching = self.data, self.data.contact.geom[: self.data.ncon]
        contacts = np.isin(self._feet, touching)
        turn = rotation(data.qpos[3:7])
        measured = controller.Measured(
            data.qpos[3:7].copy(), data.qvel[3:6].copy(), turn.T @ data.qvel[:3], data.qpos[7:].copy(), contacts
        )
        told, self._state, facts = controller.tick(
            self._config, self._body, self._solve, self._state, command, measured
        )
        self.unsolved += int(facts.unsolved)
        for _ in range(SUBSTEPS):
            wanted = told.torque + told.kp * (told.angles - data.qpos[7:]) - told.kd * data.qvel[6:]
            data.ctrl[:] = np.clip(wanted, -self._body.torque, self._body.torque)
            mujoco.mj_step(self.model, data)
        self.fell |= bool(fell(data.qpos[:7]))


def flat_c(robot: Robot, friction: float, mass: float) -> mujoco.MjModel:
    """The robot on flat ground."""
    model = scene_spec(nowhere(), robot).compile()
    model.geom_friction[model.geom_priority == 1, 0] = friction
    model.body_mass *= mass
    model.body_inertia *= mass
    return model


def c(robot: Robot) -> dict[str, Any]:
    """Commands tracked in C MuJoCo: the extremes."""
    corners = [command for command in COMMANDS if all(command)]
    rows = []
    for command, (friction, mass) in itertools.product(
        corners, [(1.0, 1.0), *itertools.product((0.5, 1.25), (0.8, 1.2))]
    ):
        walker, poses = Walker(robot, flat_c(robot, friction, mass)), []
        for tick in range(round(SECONDS / TICK)):
            if tick % TICKS == 0:
                poses.append(walker.data.qpos[:7].copy())
            walker.tick(np.array(command))
        about = {"command": command, "friction": friction, "mass": mass, "fell": walker.fell}
        rows.append(about | {"unsolved": walker.unsolved} | errors(np.stack(poses), command))
    return tracked(rows)


def push(robot: Robot) -> dict[str, Any]:
    """Sideways pushes at 16 moments of the gait, from both sides, while walking ahead at 0.3 m/s, in C MuJoCo."""
    model, rows = flat_c(robot, 1.0, 1.0), []
    for part, side in itertools.product(range(16), (-1, 1)):
        walker, begin = Walker(robot, model), 2.0 + part / 16 * WholeBodyConfig().gait.cycle
        roll, before, after = 0.0, 0.0, 0.0
        for tick in range(round(6.0 / TICK)):
            pushed = begin <= tick * TICK < begin + PUSHED
            walker.data.xfrc_applied[1, 1] = side * PUSH * pushed
            before = before if tick * TICK > begin else float(walker.data.qpos[1])
            walker.tick(np.array([0.3, 0.0]))
            x = walker.data.qpos[4]
            roll = max(roll, abs(2 * float(x)))
            after += abs(float(walker.data.qvel[1])) * TICK * (tick * TICK > 5.0)
        aside = side * (float(walker.data.qpos[1]) - before)
        rows.append({"part": part / 16, "side": side, "fell": walker.fell, "roll": roll, "aside": aside, "sway": after})
    fallen = sum(row["fell"] for row in rows)
    return {"newtons": PUSH, "seconds": PUSHED, "cases": len(rows), "fell": fallen, "rows": rows}


def blocks(robot: Robot) -> dict[str, Any]:
    """Walking straight ahead on `heightfield` in MJX: its obstacles there, and taken away."""
    scenes = make_pool(jax.random.PRNGKey(1), get_task("heightfield"), EPISODES)
    bare = scenes.replace(boxes=scenes.boxes.replace(center=scenes.boxes.center.at[:, :, 2].add(-100.0)))
    both = jax.tree.map(lambda a, b: jp.concatenate([a, b]), scenes, bare)
    ground = jax.jit(jax.vmap(ground_height))
    count, zero = 2 * EPISODES, jp.zeros(2 * EPISODES)
    starts = np.stack([standing(robot, float(z)) for z in ground(both, zero, zero)])
    one = nominal_dynamics(robot.kp, robot.kd)
    dynamics = jax.tree.map(lambda x: jp.broadcast_to(x, (count, *x.shape)), one)
    poses, unsolved = walk_mjx(robot, both, starts, np.tile([0.3, 0.0], (count, 1)), dynamics)
    below = np.stack([np.asarray(ground(both, jp.asarray(pose[:, 0]), jp.asarray(pose[:, 1]))) for pose in poses])
    survived = ~fell(poses, below).any(axis=0)
    parts = {"obstacles": slice(0, EPISODES), "no_obstacles": slice(EPISODES, count)}
    found = {"seconds": SECONDS, "speed": 0.3, "episodes": EPISODES, "unsolved": int(unsolved.sum())}
    for name, part in parts.items():
        ahead = poses[-1, part, 0]
        found[name] = {"survived": float(survived[part].mean()), "distance": float(ahead[survived[part]].mean())}
    return found


def main() -> None:
    """Runs the parts that the command line names, or all."""
    parts = {"flat": flat, "c": c, "blocks": blocks, "push": push}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="which; all if none")
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    for name in options.parts or parts:
        found = parts[name](get_robot("a1"))
        (RESULTS / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n")
        print(name, {key: value for key, value in found.items() if key != "rows"})


if __name__ == "__main__":
    main()
