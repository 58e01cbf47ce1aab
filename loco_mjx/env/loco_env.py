"""One robot in one scene, as a Brax-style environment: written for one environment, made to be vmapped."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jp

from loco_mjx import rotations
from loco_mjx.config import EnvConfig
from loco_mjx.controllers import get_controller
from loco_mjx.depth.encoding import blind_pixels, encode
from loco_mjx.depth.render import render
from loco_mjx.env import metrics, privileged, randomization, reward
from loco_mjx.env import observation as obs_lib
from loco_mjx.env.action import scale, to_offsets
from loco_mjx.env.drive import Moved, make_drive
from loco_mjx.env.state import Episode, State, World
from loco_mjx.physics import model as physics_model
from loco_mjx.physics.step import SubstepTrace, initial_state
from loco_mjx.robots import get_robot
from loco_mjx.scene import motion, pool, query, surface
from loco_mjx.scene.tasks import get_task
from loco_mjx.scene.types import Scene


class LocoEnv:
    """A task of the LocoTransformer paper.

    Actions are (12,), or (6,) with `diagonal`, in [−1, 1]: joint targets around the default pose, in units of
    `action.scale`; values outside are clipped. Under controller `mpc` they are (2,): speed ahead and yaw rate, in units
    of its limits. Observations are a dict: `state` (93,) and `pixels/depth` (64, 64, 4), unnormalised state and encoded
    depth, newest first. `step` does not reset; see :mod:`loco_mjx.env.autoreset`.
    """

    def __init__(self, config: EnvConfig) -> None:
        """Builds the physics model of the task.

        Raises:
            UnknownNameError: if the task, the robot or a term of the reward is unknown.
            UserError: if the robot's MJCF does not fit, or not the controller.
        """
        self.config = config
        self.task, self.robot = get_task(config.task), get_robot(config.robot)
        reward.weights(config.reward)  # refuses unknown terms
        self._model = physics_model.build(self.robot, config.physics, self.task.obstacle_slots)
        self._drive = make_drive(self._model, config)

    @property
    def physics(self) -> physics_model.PhysicsModel:
        """The physics of its robot, as its control steps use it."""
        return self._model

    @property
    def action_size(self) -> int:
        """Dimension of the action."""
        return self.config.action_size

    @property
    def observation_size(self) -> dict[str, tuple[int, ...]]:
        """Shape of each part of the observation."""
        return obs_lib.shapes(self.config.observation)

    @property
    def dt(self) -> float:
        """Duration of a control step, s."""
        return 1 / get_controller(self.config.controller).rate(self.robot)

    # Scenes ---------------------------------------------------------------------------------------------------------

    def make_pool(self, key: jax.Array, size: int) -> Scene:
        """`size` scenes with a leading axis, to reset into."""
        return pool.make_pool(key, self.task, size)

    def draw(self, key: jax.Array, scenes: Scene) -> Scene:
        """One scene of a pool, uniformly."""
        return pool.draw(key, scenes)

    # The Brax interface ---------------------------------------------------------------------------------------------

    def reset(self, key: jax.Array) -> State:
        """Starts an episode in a newly drawn scene."""
        scene_key, start_key = jax.random.split(key)
        return self.observe(self.reset_to(start_key, self.task.generate(scene_key)))

    def step(self, state: State, action: jax.Array) -> State:
        """One control step."""
        return self.observe(self.advance(state, action))

    # Their parts ----------------------------------------------------------------------------------------------------

    def reset_to(self, key: jax.Array, scene: Scene) -> State:
        """The first state of an episode in the given scene, without its observation."""
        place_key, robot_key, episode_key = jax.random.split(key, 3)
        qpos = self._start_pose(place_key, scene)
        episode = Episode(
            step=jp.zeros((), jp.int32),
            start=qpos[:3],
            first_obstacle=query.first_obstacle_x(scene),
            last_action=jp.zeros(len(scale(self.config))),
            history=obs_lib.first_history(self.config.observation, self.robot),
        )
        physics = initial_state(qpos)
        how = randomization.draw(robot_key, self.config)
        world = World(physics, scene, how, episode, self._drive.begin(physics))
        info = {"key": episode_key, "truncation": jp.zeros(())}
        blank = {name: jp.zeros(shape) for name, shape in self.observation_size.items()}
        none_yet = metrics.before_first_step(self.config.reward, self._drive.metrics)
        return State(world, blank, jp.zeros(()), jp.zeros(()), none_yet, info)

    def advance(self, state: State, action: jax.Array) -> State:
        """Physics, reward and termination of one control step; the observation's pixels are left as they were."""
        command = to_offsets(action, self.config)
        scene = self.next_scene(state)
        before: World = state.pipeline_state
        moved = self._drive.move(before.physics, before.control, scene, command, before.randomization.dynamics)
        return self.finish_step(state, scene, moved, command)

    def next_scene(self, state: State) -> Scene:
        """The scene during the next control step: what moves has moved."""
        world: World = state.pipeline_state
        if not self.task.moving:
            return world.scene
        _, motion_key = jax.random.split(state.info["key"])
        return motion.move(motion.redraw(motion_key, world.scene, world.episode.step), self.dt)

    def finish_step(self, state: State, scene: Scene, moved: Moved, command: jax.Array) -> State:
        """Reward, termination and metrics of a control step, whoever computed its physics.

        Args:
            state: before the step.
            scene: during the step, from :meth:`next_scene`.
            moved: what came of it.
            command: (12,) joint targets relative to the default pose, rad; or of the whole-body controller (2,).
        """
        key, _ = jax.random.split(state.info["key"])
        before: World = state.pipeline_state
        finite = _all_finite(moved.physics) & _all_finite(moved.trace)
        # A non-finite state ends the episode and goes no further: the robot is put back where it was.
        physics = _where(finite, moved.physics, before.physics)
        trace = _where(finite, moved.trace, jax.tree.map(jp.zeros_like, moved.trace))
        scene, spheres = query.collect(scene, physics.qpos[:2])
        control = _where(finite, moved.memory, before.control)
        world = replace(before, physics=physics, scene=scene, control=control)
        inputs = self._inputs(before, world, trace, spheres, command, finite)
        return self._result(state, world, trace, inputs, moved.facts, key)

    def observe(self, state: State) -> State:
        """Fills the observation; renders one depth frame where depth is enabled."""
        config, world = self.config.observation, state.pipeline_state
        qpos = world.physics.qpos
        goal = obs_lib.goal_in_base(world.scene.goal, qpos) if config.goal else None
        obs = {"state": obs_lib.state_vector(world.episode.history, goal)}
        if config.privileged:
            obs["privileged"] = privileged.observe(world.scene, self.robot.stand_height, qpos, world.physics.qvel)
        info = dict(state.info)
        if config.depth.enabled:
            info["key"], blind_key = jax.random.split(state.info["key"])
            depth = render(world.scene, qpos, self.robot.camera, config.depth)
            noise = config.depth.noise if config.depth.noise is not None else self.config.randomization.enabled
            if noise:
                depth = blind_pixels(blind_key, depth, config.depth)
            first = world.episode.step == 0
            obs["pixels/depth"] = obs_lib.push_frame(state.obs["pixels/depth"], encode(depth), first)
        return state.replace(obs=obs, info=info)

    # Details --------------------------------------------------------------------------------------------------------

    def _start_pose(self, key: jax.Array, scene: Scene) -> jax.Array:
        # x, y = +U(-start_range, start_range)
        reach = self.config.start_range
        xy = jax.random.uniform(key, (2,), minval=-reach, maxval=reach)
        feet_x, feet_y = (xy[i] + jp.array([foot[i] for foot in self.robot.feet]) for i in range(2))
        ground = jp.max(jax.vmap(lambda x, y: surface.ground_height(scene, x, y))(feet_x, feet_y))
        quat = jp.array([1.0, 0.0, 0.0, 0.0])
        return jp.concatenate([xy, (ground + self.robot.stand_height)[None], quat, jp.array(self.robot.default_pose)])

    def _inputs(
        self,
        before: World,
        after: World,
        trace: SubstepTrace,
        spheres: jax.Array,
        command: jax.Array,
        finite: jax.Array,
    ) -> reward.RewardInputs:
        start, end, origin = before.physics.qpos[:3], after.physics.qpos[:3], before.episode.start
        forward = reward.forward_displacement(start, end, after.scene.goal, self.task.toward_goal)
        change = command - before.episode.last_action
        straight = jp.linalg.norm(end - origin) - jp.linalg.norm(start - origin)
        return reward.RewardInputs(
            displacement=end - start,
            velocity=(end - start) / self.dt,
            forward=forward,
            forward_velocity=forward / self.dt,
            speed=reward.forward_speed(forward / self.dt, self.config.reward),
            distance=straight if self.task.toward_goal else (end - start)[0],
            goal_distance=jp.linalg.norm(after.scene.goal - end) if self.task.toward_goal else jp.array(jp.inf),
            torque_squared=trace.torque_squared,
            spheres=spheres.astype(jp.float32),
            contact=trace.obstacle_contact.astype(bool),
            passed=end[0] > before.episode.first_obstacle,
            dropped=trace.dropped.astype(jp.float32),
            action=command,
            last_action=before.episode.last_action,
            action_change=jp.sum((change / jp.array(scale(self.config))) ** 2),
            up=rotations.upright(after.physics.qpos[3:7]),
            height=end[2] - surface.ground_height(after.scene, end[0], end[1]),
            qpos=after.physics.qpos,
            qvel=after.physics.qvel,
            finite=finite,
        )

    def _result(
        self,
        state: State,
        world: World,
        trace: SubstepTrace,
        inputs: reward.RewardInputs,
        facts: dict[str, jax.Array],
        key: jax.Array,
    ) -> State:
        terms = reward.rewards(inputs, self.config.reward)
        latency, dt = world.randomization.latency, self.robot.physics_dt
        readings = obs_lib.sense(trace, latency, dt, inputs.action, inputs.displacement, inputs.velocity)
        episode = replace(
            world.episode,
            step=world.episode.step + 1,
            last_action=inputs.action,
            history=obs_lib.push(world.episode.history, readings),
        )
        ended = reward.terminated(inputs, self.config.termination) | ~inputs.finite
        truncated = (episode.step >= self.config.horizon) & ~ended
        # What a wrapper keeps among the metrics and in the info stays there.
        return state.replace(
            pipeline_state=replace(world, episode=episode),
            reward=sum(terms.values()),
            done=(ended | truncated).astype(jp.float32),
            metrics=state.metrics | metrics.measure(inputs, terms, facts),
            info=state.info | {"key": key, "truncation": truncated.astype(jp.float32)},
        )


def _all_finite(tree: Any) -> jax.Array:
    leaves = [x for x in jax.tree.leaves(tree) if jp.issubdtype(x.dtype, jp.floating)]
    return jp.all(jp.stack([jp.all(jp.isfinite(x)) for x in leaves]))


def _where(choice: jax.Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jp.where(choice, a, b), yes, no)
