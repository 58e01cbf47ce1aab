"""Control steps: what the robot does in simple worlds, what randomisation changes, and how environments stay apart."""

from __future__ import annotations

import dataclasses
import re

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import PhysicsConfig
from loco_mjx.physics.kinematics import sphere_centers
from loco_mjx.physics.model import build
from loco_mjx.physics.step import PhysicsState, control_step, initial_state, nominal_dynamics
from loco_mjx.scene.types import OBSTACLE, STEP, WALL
from tests.known_robots import A1
from tests.physics.world import (
    BATCH,
    GAIT_KD,
    GAIT_KP,
    nominal,
    physics,
    rollout,
    scene,
    standing,
    stepper,
    still,
    trot_targets,
)

SAG = 0.240  # m, height that kp 40 holds the trunk at; C MuJoCo's figure


def _gait():
    return nominal_dynamics(GAIT_KP, GAIT_KD)


def _lowest_gap(states: PhysicsState, surface) -> float:
    """Smallest value of surface(x, y, z) − radius over all spheres and states, m."""
    flat = states.qpos.reshape(-1, 19)
    x, y, z = jax.vmap(lambda qpos: sphere_centers(A1, qpos))(flat)
    return float(np.min(surface(np.asarray(x), np.asarray(y), np.asarray(z)) - np.asarray(A1.radii)))


def test_dropped_robot_settles_at_the_height_its_gains_hold():
    states, outcome = rollout([standing(height=0.4)], [scene()], still(50))
    assert states.qpos[0, -1, 2] == pytest.approx(SAG, abs=0.002)
    assert np.abs(states.qvel[0, -1]).max() < 0.05
    np.testing.assert_allclose(states.qpos[0, -1, 3:7], [1, 0, 0, 0], atol=0.05)
    assert not outcome.obstacle_contact.any()
    # Standing still, the motors' torques are what holds the legs: τ = kp (target − angle).
    final = A1.kp * (still(1)[0] - states.qpos[0, -1, 7:])
    assert outcome.torque_squared[0, -1] == pytest.approx(np.sum(final**2), rel=0.01)


def test_outcome_traces_the_step():
    start = initial_state(standing(height=0.3))
    states, outcome = rollout([start], [scene()], trot_targets(2))
    assert outcome.angles.shape[2:] == (17, 12) and outcome.quat.shape[2:] == (17, 4)
    np.testing.assert_array_equal(outcome.angles[0, 0, 0], start.qpos[7:])
    np.testing.assert_array_equal(outcome.angles[0, 0, 16], states.qpos[0, 0, 7:])
    np.testing.assert_array_equal(outcome.angles[0, 1, 0], states.qpos[0, 0, 7:])
    np.testing.assert_array_equal(outcome.quat[0, 1, 16], states.qpos[0, 1, 3:7])
    np.testing.assert_array_equal(outcome.gyro[0, 1, 0], states.qvel[0, 0, 3:6])
    assert np.abs(np.diff(outcome.angles[0, 0], axis=0)).max(axis=1).min() > 0  # every physics step moves


def test_free_fall():
    limp = dataclasses.replace(nominal(), motor_strength=jp.zeros(12))
    states, outcome = rollout([standing(height=2.0)], [scene()], still(5), [limp])
    time = 5 * A1.control_dt
    # Semi-implicit Euler falls half a physics step further than ½ g t².
    expected = 2.0 - 0.5 * 9.81 * time * (time + A1.physics_dt)
    assert states.qpos[0, -1, 2] == pytest.approx(expected, abs=1e-4)
    assert states.qvel[0, -1, 2] == pytest.approx(-9.81 * time, rel=1e-4)
    assert outcome.torque_squared.max() == 0.0


def test_walking_into_a_wall_ends_at_the_wall():
    wall = {"center": (0.8, 0.0, 0.5), "half": (0.2, 5.0, 0.5), "kind": WALL}
    tree = {"center": (0.8, 0.0, 0.5), "radius": 0.2, "half_height": 0.5}
    tall = {"center": (0.8, 0.0, 0.5), "half": (0.25, 5.0, 0.5), "kind": STEP}
    worlds = [scene([wall]), scene([], [tree]), scene([tall]), scene()]
    states, outcome = rollout([standing()], worlds, trot_targets(60), [_gait()])
    assert states.qpos[3, -1, 0] > 0.6  # without anything in the way it walks on
    face = 0.8 - 0.2 - 0.05
    for env in (0, 2):
        assert states.qpos[env, -1, 0] < face
        one = jax.tree.map(lambda x, env=env: x[env], states)
        assert _lowest_gap(one, lambda x, y, z: face - x) > -0.015
    outside = jax.tree.map(lambda x: x[1], states)
    assert _lowest_gap(outside, lambda x, y, z: np.hypot(x - 0.8, y) - 0.25) > -0.015
    assert outcome.obstacle_contact[0].any() and outcome.obstacle_contact[1].any()
    assert not outcome.obstacle_contact[2:].any()  # a step is no obstacle; nothing is none either


def test_no_sphere_sinks_into_ground_box_or_edge():
    # Dropped onto a step, half over its edge, and onto the corner of a turned obstacle.
    step = {"center": (0.0, 0.0, 0.05), "half": (5.0, 5.0, 0.05), "kind": STEP}
    half = {"center": (2.5, 0.0, 0.05), "half": (2.5, 5.0, 0.05), "kind": STEP}
    turned = {"center": (0.35, 0.1, 0.1), "half": (0.2, 0.2, 0.1), "yaw": 0.6, "kind": OBSTACLE}
    worlds = [scene([step]), scene([half]), scene([turned]), scene()]
    states, _ = rollout([standing(height=0.45)], worlds, still(60))
    assert np.isfinite(states.qpos).all()
    assert states.qpos[0, -1, 2] == pytest.approx(SAG + 0.1, abs=0.005)
    on_step = jax.tree.map(lambda x: x[0], states)
    assert _lowest_gap(on_step, lambda x, y, z: z - 0.1) > -0.02  # the landing itself, at 2 m/s
    assert _lowest_gap(states, lambda x, y, z: z) > -0.03


def test_everything_beneath_the_robot_carries_it():
    """Four stones and three blocks under the belly; three by three tiles: no foot falls through."""
    stones = [{"center": (x, y, 0.1), "half": (0.06, 0.06, 0.1)} for x in (-0.183, 0.183) for y in (-0.132, 0.132)]
    blocks = [{"center": (x, 0.0, 0.1), "half": (0.04, 0.04, 0.1)} for x in (-0.1, 0.0, 0.1)]
    tiles = [{"center": (x, y, 0.1), "half": (0.15, 0.15, 0.1)} for x in (-0.3, 0.0, 0.3) for y in (-0.3, 0.0, 0.3)]
    worlds = [scene([*blocks, *stones]), scene(tiles), scene([*tiles[::-1]]), scene()]
    states, outcome = rollout([standing(height=0.2 + A1.stand_height)], worlds, still(10), [_gait()])
    height = states.qpos[:, -1, 2]
    np.testing.assert_allclose(height[:3], height[0], atol=2e-3)
    assert height[0] > 0.2 + SAG and height[3] < 0.35
    assert outcome.dropped.max() == 0


def test_friction_decides_whether_feet_slide():
    settled, _ = rollout([standing()], [scene()], still(20))
    settled = jax.tree.map(lambda x: jp.asarray(x[0, -1]), settled)
    slide = dataclasses.replace(settled, qvel=settled.qvel.at[0].add(0.5))
    grip, ice = nominal(friction=1.0), nominal(friction=0.1)
    states, _ = rollout([slide], [scene()], still(12), [grip, ice])
    went = states.qpos[:2, -1, 0] - settled.qpos[0]
    assert went[0] < 0.0  # it stops, and swings back on its legs
    assert went[1] > 0.03


def test_randomisation_changes_what_it_should():
    base = nominal()
    change = dataclasses.replace
    variants = [
        change(base, mass=jp.float32(1.2)),
        change(base, kp=jp.float32(80.0)),
        change(base, motor_strength=jp.full(12, 0.8)),
    ]
    states, _ = rollout([standing()], [scene()], still(50), [base, *variants])
    usual, heavy, stiff, weak = states.qpos[:, -1, 2]
    # What the legs give way by is in proportion to the weight they carry, and to the inverse of their stiffness.
    assert heavy < usual - 0.004
    assert stiff > usual + 0.01
    assert weak < usual - 0.004

    falling = PhysicsState(jp.asarray(standing(height=1.0)), jp.zeros(18).at[6:].set(3.0), jp.zeros(18))
    limp = change(base, motor_strength=jp.zeros(12))
    states, _ = rollout(
        [falling],
        [scene()],
        still(2),
        [limp, change(limp, inertia=jp.float32(1.5)), change(limp, motor_friction=jp.float32(0.05)), limp],
    )
    speed = np.abs(states.qvel[:, -1, 6:]).mean(axis=1)
    assert abs(speed[1] - speed[0]) > 1e-3  # other inertia, other motion
    assert speed[2] < speed[0] - 0.05  # friction brakes
    np.testing.assert_array_equal(states.qvel[3], states.qvel[0])


def test_joint_limits_hold():
    beyond = np.tile(np.array([[2.0, 0.9, 0.5] * 4], np.float32), (15, 1))
    states, _ = rollout([standing(height=3.0)], [scene()], beyond)
    overshoot = np.maximum(states.qpos[0, -1, 7:] - np.array(A1.upper), 0.0)
    assert 0.0 < overshoot.max() < 0.06  # kp would push it on by 1.2 rad


def test_one_environment_is_what_a_batch_of_it_is():
    world, target = scene([{"center": (0.3, 0.1, 0.05), "half": (0.2, 0.2, 0.05)}]), jp.asarray(trot_targets(3)[2])
    state = initial_state(standing(height=0.29))
    model = physics()
    alone = jax.jit(lambda *args: control_step(model, *args))(state, world, target, nominal())
    spread = lambda tree: jax.tree.map(lambda x: jp.broadcast_to(x, (BATCH, *jp.shape(x))), tree)  # noqa: E731
    many = stepper()(spread(state), spread(world), spread(target), spread(nominal()))
    # Not to the last bit: another program rounds otherwise, and a landing magnifies it.
    for name, tolerance in {"qpos": 2e-3, "qvel": 0.1}.items():
        np.testing.assert_allclose(getattr(alone[0], name), getattr(many[0], name)[1], atol=tolerance)
    np.testing.assert_allclose(alone[1].angles, many[1].angles[1], atol=2e-3)
    assert alone[1].obstacle_contact == many[1].obstacle_contact[1]


def test_a_broken_environment_stays_broken_and_alone():
    broken = PhysicsState(jp.asarray(standing()).at[9].set(jp.nan), jp.zeros(18), jp.zeros(18))
    good = initial_state(standing())
    mixed, _ = rollout([good, broken, good], [scene()], trot_targets(3))
    clean, _ = rollout([good], [scene()], trot_targets(3))
    assert not np.isfinite(mixed.qpos[1, -1]).all()
    for env in (0, 2, 3):
        np.testing.assert_array_equal(mixed.qpos[env], clean.qpos[env])


def test_states_keep_their_types():
    state, world, how = initial_state(standing()), scene(), nominal()
    model = physics()
    after, outcome = jax.eval_shape(lambda *args: control_step(model, *args), state, world, jp.zeros(12), how)
    for before, new in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        assert (new.shape, new.dtype, new.weak_type) == (before.shape, before.dtype, False)
    assert outcome.obstacle_contact.dtype == bool and outcome.obstacle_contact.shape == ()
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(outcome))


def test_no_lapack():
    """Two CPU devices that call LAPACK at once can wait for each other for ever (jaxlib 0.10); physics must not."""
    start = jax.tree.map(lambda x: jp.stack([x] * BATCH), (initial_state(standing()), scene(), nominal()))
    lowered = stepper().lower(start[0], start[1], jp.zeros((BATCH, 12)), start[2])
    assert "lapack" not in lowered.as_text()


def _shapes(program):
    """Of everything that a lowered program computes, but for what only rearranges."""
    for line in program.splitlines():
        operation = re.search(r"stablehlo\.(\w+)", line)
        if operation and operation[1] not in ("reshape", "broadcast_in_dim", "return"):
            result = line.rpartition("->")[2] if "->" in line else line.rpartition(":")[2]
            yield from (tuple(map(int, shape.split("x"))) for shape in re.findall(r"tensor<([\dx]*\d)x[a-z]", result))


def test_seeds_of_environments_are_one_larger_batch():
    """Two nested vmaps compute with all environments on the last axis: no loop over seeds, no axis of their own."""
    model = build(A1, PhysicsConfig(iterations=1, ls_iterations=1, more_iterations=1))

    def step(state, scene):
        targets, dynamics = jp.asarray(still(1)[0]), nominal()
        return control_step(model, state, scene, targets, dynamics)

    one = (initial_state(standing()), scene())
    nested = jax.tree.map(lambda x: jp.broadcast_to(x, (5, 7, *jp.shape(x))), one)
    shapes = list(_shapes(jax.jit(jax.vmap(jax.vmap(step))).lower(*nested).as_text()))
    assert sum(shape[-1:] == (35,) for shape in shapes) > 1000
    assert not [shape for shape in shapes if 5 in shape and 7 in shape]
