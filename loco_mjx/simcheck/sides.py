"""The two worlds of a comparison: our environment, and C MuJoCo's robot behind the deployment's robot protocol.

Scenes, starts, rewards, terminations and metrics are the environment's on both sides. On C's side everything else is
independent: physics on the full scene with its real geoms, depth by mj_multiRay, the observation by the deployment's
NumPy code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from typing import Any

import jax
import jax.numpy as jp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from loco_mjx.deploy.depth_hold import DepthHold
from loco_mjx.deploy.description import DEPTH, STATE
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.mujoco_robot import HIDDEN_GROUP, SEEN_GROUP, MujocoRobot
from loco_mjx.env.action import from_offsets, neutral
from loco_mjx.env.drive import Moved
from loco_mjx.env.loco_env import LocoEnv
from loco_mjx.env.state import State
from loco_mjx.evaluation.episodes import keys_of
from loco_mjx.physics.step import PhysicsState, SubstepTrace
from loco_mjx.robots import LEGS
from loco_mjx.scene import mjcf
from loco_mjx.scene.types import Scene
from loco_mjx.sharding import AXIS, shard_map
from loco_mjx.simcheck.follow import make_follower

Policy = Callable[[Mapping[str, np.ndarray]], np.ndarray]
KEYS = {STATE: "state", DEPTH: "pixels/depth"}
ROUGH = tuple(f"{leg}_{part}_sphere" for part in ("foot", "knee") for leg in LEGS)  # what friction holds


def start(env: LocoEnv, seed: int, episodes: int) -> State:
    """The first states of some episodes, batched: the ones that an evaluation with that seed has."""
    return jax.jit(jax.vmap(lambda episode: env.reset(keys_of(seed, episode)[0])))(jp.arange(episodes))


class MjxSide:
    """Our environment."""

    name = "MJX"

    def __init__(self, env: LocoEnv, manifest: Manifest, policy: Policy, pool: Executor, mesh: Mesh) -> None:
        """Prepares the program; `pool` runs the policy, `mesh` is of `make_mesh`."""
        self._manifest, self._policy, self._pool = manifest, policy, pool
        self._mesh = mesh
        self._config = env.config
        advance = shard_map(jax.vmap(env.step), mesh, P(AXIS), P(AXIS))
        # Arrays without elements would come back otherwise placed, and the second step would compile again.
        self._advance = jax.jit(advance, out_shardings=NamedSharding(mesh, P(AXIS)))
        self._held = DepthHold(manifest.hold)

    def begin(self, state: State) -> State:
        """Takes the first states."""
        return jax.device_put(state, NamedSharding(self._mesh, P(AXIS)))

    def step(self, state: State, t: int, alive: np.ndarray) -> State:
        """One control step of every episode; those not alive act by the default pose."""
        obs = {name: np.asarray(state.obs[KEYS[name]]) for name in self._manifest.shapes}
        if DEPTH in obs:
            obs[DEPTH] = self._held(obs[DEPTH])
        offsets = np.zeros((len(alive), self._manifest.controller.size))
        going = np.flatnonzero(alive)
        targets = list(self._pool.map(lambda i: self._policy({name: obs[name][i] for name in obs}), going))
        if targets:
            offsets[going] = np.array(targets) - neutral(self._config)
        return self._advance(state, jp.asarray(from_offsets(offsets, self._config), jp.float32))


class WatchedRobot(MujocoRobot):
    """C MuJoCo's robot, of which is known what the reward needs.

    Attributes:
        torque_squared: sum over the physics steps of the sum of squared torques, (N·m)².
        contact: whether any part has touched an obstacle or a wall.
    """

    def __init__(self, model: Any, *args: Any, **more: Any) -> None:
        solid = [model.geom(i).name.endswith(f"_{mjcf.CONTACT}") for i in range(model.ngeom)]
        steps = [model.geom(i).name.startswith("step_") for i in range(model.ngeom)]
        self._solid = np.array(solid) & ~np.array(steps)
        self.forget()
        super().__init__(model, *args, **more)

    def put(self, qpos: np.ndarray, qvel: np.ndarray, collected: np.ndarray) -> None:
        """Puts it into a state, in the present scene with those of its spheres (n,) collected."""
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        self.data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self.model, self.data)
        for geom in range(self.model.ngeom):
            kind, _, index = self.model.geom(geom).name.partition("sphere_")
            if index and not kind:
                self.model.geom_group[geom] = HIDDEN_GROUP if collected[int(index)] else SEEN_GROUP
        self.forget()
        self._sense()
        self._expose(first=True)

    def forget(self) -> None:
        """Starts a new control step."""
        self.torque_squared, self.contact = 0.0, False

    def _step(self, torque: np.ndarray) -> None:
        """One physics step; contacts are those at its start, as in ours."""
        super()._step(torque)
        self.torque_squared += float(self.data.ctrl @ self.data.ctrl)
        if not self.contact and self.data.ncon:
            touching = self.data.contact.geom[self.data.contact.dist < 0]
            self.contact = bool(self._solid[touching].any())


def _finished(env: LocoEnv, *step: Any) -> State:
    """`env.finish_step`, whose key is then what `env.observe` leaves: what is drawn is the same on both sides."""
    state = env.finish_step(*step)
    if not env.config.observation.depth.enabled:
        return state
    return state.replace(info=state.info | {"key": jax.random.split(state.info["key"])[0]})


class CSide:
    """C MuJoCo, one full model per episode."""

    name = "C MuJoCo"

    def __init__(self, env: LocoEnv, manifest: Manifest, policy: Policy, pool: Executor, prisms: bool = False) -> None:
        """Prepares the programs; `pool` runs the episodes, `prisms` is of MujocoRobot."""
        self._prisms = prisms
        self._env, self._manifest, self._policy, self._pool = env, manifest, policy, pool
        self._next_scene = jax.jit(jax.vmap(env.next_scene))
        self._finish_step = jax.jit(jax.vmap(partial(_finished, env)))
        self.robots: list[WatchedRobot] = []

    def begin(self, state: State) -> State:
        """Builds the scenes of the first states and puts the robots where those have them."""
        scenes = jax.tree.map(np.asarray, state.pipeline_state.scene)
        starts = np.asarray(state.pipeline_state.physics.qpos, np.float64)
        self.robots = list(self._pool.map(lambda i: self._robot(one(scenes, i), starts[i]), range(len(starts))))
        self._followers = [make_follower(self._manifest, self._env.robot) for _ in starts]
        self._targets = np.tile(neutral(self._env.config), (len(starts), 1))
        return state

    def _robot(self, scene: Scene, qpos: np.ndarray) -> WatchedRobot:
        model = mjcf.scene_spec(scene, self._env.robot).compile()
        model.key_qpos[0] = qpos
        for name in ROUGH:
            model.geom(name).friction[0] = self._env.config.physics.friction
        how: dict[str, Any] = {"lying": False, "prisms": self._prisms, "policy_hz": self._manifest.policy_hz}
        return WatchedRobot(model, self._manifest.camera, **how)

    def step(self, state: State, t: int, alive: np.ndarray) -> State:
        """One control step of every episode that is alive; the others stay where they are."""
        scene = self._next_scene(state) if self._env.task.moving else state.pipeline_state.scene
        if self._env.task.moving:
            for i in np.flatnonzero(alive):
                robot = self.robots[i]
                mjcf.place_boxes(robot.model, robot.data, one(scene, i))
        list(self._pool.map(self._control_step, np.flatnonzero(alive)))
        command = jp.asarray(self._targets - neutral(self._env.config), jp.float32)
        return self._finish_step(state, scene, self._measured(state), command)

    def _control_step(self, i: int | np.integer) -> None:
        robot = self.robots[i]
        self._targets[i] = self._policy(self._followers[i].observe(robot, self._targets[i]))
        robot.forget()
        self._followers[i].follow(robot, self._targets[i])

    def _measured(self, state: State) -> Moved:
        """What the physics would say of this step; its traces are the last moment's, whose history nobody reads."""
        qpos = jp.asarray(np.array([robot.data.qpos for robot in self.robots]), jp.float32)
        qvel = jp.asarray(np.array([robot.data.qvel for robot in self.robots]), jp.float32)
        substeps = round(self._env.dt / self._env.robot.physics_dt)
        trace = [jp.repeat(x[:, None], substeps + 1, axis=1) for x in (qpos[:, 7:], qpos[:, 3:7], qvel[:, 3:6])]
        squared = jp.asarray([robot.torque_squared / substeps for robot in self.robots], jp.float32)
        contact = jp.asarray([robot.contact for robot in self.robots])
        dropped = jp.zeros(len(self.robots), jp.int32)  # C feels everything
        facts = [follower.facts() for follower in self._followers]
        return Moved(
            PhysicsState(qpos, qvel, jp.zeros_like(qvel)),
            state.pipeline_state.control,  # which nobody reads: the followers remember
            SubstepTrace(squared, contact, dropped, *trace),
            {name: jp.asarray([one[name] for one in facts], jp.float32) for name in facts[0]},
        )


def one(tree: Any, i: int | np.integer) -> Any:
    """One episode's part of a batch."""
    return jax.tree.map(lambda leaf: np.asarray(leaf[i]), tree)
