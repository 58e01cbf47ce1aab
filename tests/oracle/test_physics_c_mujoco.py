"""Physics against C MuJoCo with its solver converged: steps, paths, a walk through a scene; ours as users have it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import RandomizationConfig
from loco_mjx.deploy.terrain_contacts import TerrainContacts
from loco_mjx.physics.compiled import compiled
from loco_mjx.physics.links import links
from loco_mjx.physics.step import Dynamics, PhysicsState, SubstepTrace, initial_state, nominal_dynamics
from loco_mjx.robots import LEGS
from loco_mjx.robots.motor import motor_torque
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.tasks import get_task
from loco_mjx.scene.types import OBSTACLE, STEP, Scene
from tests.known_robots import A1
from tests.physics import world
from tests.physics.world import (
    CONVERGED,
    c_rollout,
    flat_c_model,
    nominal,
    scene,
    standing,
    trot_targets,
)
from tests.quick import QUICKLY

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

GAIT = (world.GAIT_KP, world.GAIT_KD)

_heightfield = jax.jit(get_task("heightfield").generate, compiler_options=QUICKLY)


def _rough(number: int) -> Scene:
    """Ground with blocks up to 5 cm high, nothing else near."""
    return scene(terrain=_heightfield(jax.random.PRNGKey(number)).terrain)


def _rollout(starts: Any, worlds: Sequence[Scene], *more: Any) -> tuple[PhysicsState, SubstepTrace]:
    """world.rollout with one program for all: what is flat is a heightfield of zeros.

    On the plane are the random states, with our solver converged too, and the trots of other robots.
    """
    shapes = jax.eval_shape(_heightfield, jax.random.PRNGKey(0)).terrain
    flat = jax.tree.map(lambda leaf: jp.zeros(leaf.shape, leaf.dtype), shapes)
    return world.rollout(starts, [w if w.terrain is not None else w.replace(terrain=flat) for w in worlds], *more)


def _gait() -> Dynamics:
    return nominal_dynamics(*GAIT)


def _error(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Distance of the trunks after each control step, m."""
    return np.linalg.norm(ours[:, :3] - theirs[:, :3], axis=1)


def _random_states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses with feet, knees, hips or trunk in the ground, velocities, targets."""
    rng = np.random.default_rng(11)
    quat = rng.normal(size=(count, 4)) * 0.3 + [1, 0, 0, 0]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    angles = np.array(A1.default_pose) + 0.5 * rng.normal(size=(count, 12))
    place = np.stack([np.zeros(count), np.zeros(count), rng.uniform(0.1, 0.27, count)], axis=1)
    targets = np.array(A1.default_pose) + 0.3 * rng.normal(size=(count, 12))
    return np.concatenate([place, quat, angles], axis=1), 0.5 * rng.normal(size=(count, 18)), targets


def _c_step(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Configuration after one control step."""
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 200, 100, 1e-12
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    for _ in range(A1.substeps):
        data.ctrl[:] = motor_torque(target, data.qpos[7:], data.qvel[6:], A1.kp, A1.kd, A1.torque_limit[0])
        mujoco.mj_step(model, data)
    return data.qpos.copy()


@pytest.mark.parametrize(("mass", "inertia", "friction"), [(1.0, 1.0, 1.0), (1.2, 0.6, 0.5)])
def test_random_states_move_as_in_c(mass, inertia, friction):
    """Any sphere may be in the ground, any joint beyond its limit: 40 ms later both are in the same place."""
    count = 3 * world.BATCH
    qpos, qvel, targets = _random_states(count)
    c_model = flat_c_model()
    c_model.body_mass *= mass
    c_model.body_inertia *= inertia
    # MuJoCo takes a constraint's softness from inverse weights of the original masses; ours scale with the mass.
    c_model.body_invweight0 /= mass
    c_model.geom_friction[:, 0] = friction
    one = jp.float32(1.0)
    how = dataclasses.replace(nominal(friction=friction), mass=mass * one, inertia=inertia * one)
    errors = []
    for first in range(0, count, world.BATCH):
        picked = range(first, first + world.BATCH)
        starts = [PhysicsState(*(jp.asarray(x, jp.float32) for x in (qpos[i], qvel[i], np.zeros(18)))) for i in picked]
        wide = targets[first : first + world.BATCH, None]
        states, _ = world.rollout(starts, [scene()], wide, [how], CONVERGED)
        for i, n in enumerate(picked):
            after = _c_step(c_model, qpos[n], qvel[n], targets[n])
            errors.append(np.abs(states.qpos[i, 0] - after).max() / np.abs(after - qpos[n]).max())
    assert np.max(errors) < 5e-6


def _spheres_in_corners(model: mujoco.MjModel, data: mujoco.MjData) -> set[str]:
    """The robot's spheres that are in contact with two things at once."""
    names = [model.geom(g).name for c in data.contact if c.dist < 0 for g in c.geom]
    return {name for name in names if name.endswith("_sphere") and names.count(name) > 1}


def _depths(data: mujoco.MjData, sphere: str) -> tuple[float, float]:
    """How deep a sphere is in the ground z = 0 and in the wall that is felt from y = 0.35, m."""
    _, y, z = data.geom(sphere).xpos
    radius = data.model.geom(sphere).size[0]
    return radius - z, y + radius - 0.35


def _kneeling_states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses on folded legs with the left knees, not the feet, about y = 0.34 m, velocities, targets that press down."""
    rng = np.random.default_rng(12)
    quat = rng.normal(size=(count, 4)) * 0.03 + [1, 0, 0, 0]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    angles = np.array([[s * 0.2, 0.9, -2.65] for s in (-1, 1, -1, 1)]).ravel() + 0.04 * rng.normal(size=(count, 12))
    place = np.stack([np.zeros(count), np.full(count, 0.175), rng.uniform(0.11, 0.13, count)], axis=1)
    targets = np.array([[s * 0.2, 0.9, -2.6] for s in (-1, 1, -1, 1)]).ravel() + 0.2 * rng.normal(size=(count, 12))
    return np.concatenate([place, quat, angles], axis=1), 0.3 * rng.normal(size=(count, 18)), targets


def test_a_knee_on_the_ground_leans_against_a_wall_as_in_c():
    """With one plane for a knee it would sink into the ground while it leans, and the robot would go down with it.

    A knee has friction against the nearest only, here the ground: C gets a wall without.
    """
    full = scene([{"center": (0.0, 0.5, 0.5), "half": (3.0, 0.1, 0.5), "kind": OBSTACLE}])  # contact from y = 0.35
    c_model = scene_spec(full, A1).compile()
    wall = c_model.geom("obstacle_0_contact").id
    c_model.geom_priority[wall], c_model.geom_condim[wall] = 2, 1
    qpos, qvel, targets = _kneeling_states(2000)
    picked = []
    for n in range(len(qpos)):
        data = mujoco.MjData(c_model)
        data.qpos[:] = qpos[n]
        mujoco.mj_forward(c_model, data)
        corners = _spheres_in_corners(c_model, data)
        if not corners or not all("knee" in name for name in corners):
            continue
        feet = [f"{leg}_foot_sphere" for leg in LEGS]
        into_wall = max(_depths(data, name)[1] for name in corners)
        free = max(_depths(data, name)[1] for name in feet) < 0
        lower = all(_depths(data, name)[0] > into_wall for name in corners)
        if free and lower and min(c.dist for c in data.contact) > -0.03:
            picked.append(n)
    picked = picked[: world.BATCH]
    assert len(picked) == world.BATCH
    starts = [PhysicsState(*(jp.asarray(x, jp.float32) for x in (qpos[i], qvel[i], np.zeros(18)))) for i in picked]
    states, _ = _rollout(starts, [full], targets[picked][:, None])
    for ours, n in zip(states.qpos[:, 0], picked, strict=True):
        after = _c_step(c_model, qpos[n], qvel[n], targets[n])
        assert np.abs(ours - after).max() / np.abs(after - qpos[n]).max() < 5e-3


def test_a_foot_stands_on_the_two_edges_of_a_gap_as_in_c():
    """Sphere of 4 cm over a gap of 3 cm between two blocks; with one slot for blocks it would fall in."""
    middle = 0.183  # x of the front feet
    full = scene([{"center": (middle + side * 0.415, 0.0, 0.1), "half": (0.4, 0.5, 0.1)} for side in (-1, 1)])
    start, targets = standing(height=0.2 + A1.stand_height), world.still(10)
    theirs = c_rollout(scene_spec(full, A1).compile(), start, targets, *GAIT)
    ours, _ = _rollout([start], [full], targets, [_gait()])
    np.testing.assert_allclose(ours.qpos[0], theirs, atol=2e-3)


def test_a_foot_squeezed_by_two_blocks_feels_both_as_in_c():
    """A sphere of 4 cm between blocks 3.8 cm apart, shoved forward; with one slot one of them would let it through."""
    middle = 0.183  # x of the front feet
    full = scene([{"center": (middle + side * 0.069, 0.0, 0.015), "half": (0.05, 0.5, 0.015)} for side in (-1, 1)])
    targets, shove = world.still(10), 0.4 * np.eye(18)[0]
    theirs = c_rollout(scene_spec(full, A1).compile(), standing(), targets, *GAIT, qvel=shove)
    start = PhysicsState(jp.asarray(standing()), jp.asarray(shove, jp.float32), jp.zeros(18))
    ours, _ = _rollout([start], [full], targets, [_gait()])
    np.testing.assert_allclose(ours.qpos[0], theirs, atol=2e-3)


def test_trot_on_flat_ground_follows_c():
    """Drift from C over 20 control steps (320 physics steps)."""
    targets = trot_targets(20)
    theirs = c_rollout(flat_c_model(), standing(), targets, *GAIT)
    ours, _ = _rollout([standing()], [scene()], targets, [_gait()])
    assert _error(ours.qpos[0], theirs).max() < 1e-5


@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_feet_slide_as_far_as_in_c(friction):
    """Pushed to 0.5 m/s. Sliding is what few iterations get wrong: they hold the feet more than friction would."""
    settled, _ = _rollout([standing()], [scene()], world.still(20))
    qpos, qvel = settled.qpos[0, -1], settled.qvel[0, -1] + 0.5 * np.eye(18)[0]
    c_model = flat_c_model()
    c_model.geom_friction[:, 0] = friction
    theirs = c_rollout(c_model, qpos, world.still(12), qvel=qvel)
    start = PhysicsState(jp.asarray(qpos), jp.asarray(qvel, jp.float32), jp.zeros(18))
    ours, _ = _rollout([start], [scene()], world.still(12), [nominal(friction=friction)])
    np.testing.assert_allclose(ours.qpos[0, -1, :3], theirs[-1, :3], atol=1e-4)


def test_a_slide_of_two_seconds_ends_where_it_does_in_c():
    """With the solver's default iterations, at every friction of the randomisation; the trot is jerky, so feet slip."""
    count, rng = 3 * world.BATCH, np.random.default_rng(5)
    frictions = np.linspace(*RandomizationConfig().friction, count)
    velocity = np.zeros((count, 18))
    velocity[:, :2] = rng.uniform(-0.7, 0.7, (count, 2))
    targets = trot_targets(50) + 0.15 * rng.normal(size=(count, 50, 12))
    errors = []
    for first in range(0, count, world.BATCH):
        picked = range(first, first + world.BATCH)
        starts = [
            PhysicsState(*(jp.asarray(x, jp.float32) for x in (standing(), velocity[i], np.zeros(18)))) for i in picked
        ]
        hows = [nominal_dynamics(*GAIT, friction=frictions[i]) for i in picked]
        ours, _ = _rollout(starts, [scene()], targets[picked], hows)
        for i, n in enumerate(picked):
            c_model = flat_c_model()
            c_model.geom_friction[:, 0] = frictions[n]
            theirs = c_rollout(c_model, standing(), targets[n], *GAIT, qvel=velocity[n])
            errors.append(np.linalg.norm(ours.qpos[i, -1, :2] - theirs[-1, :2]))
    assert np.median(errors) < 0.01
    assert np.max(errors) < 0.05


def test_landing_follows_c():
    targets = world.still(30)
    theirs = c_rollout(flat_c_model(), standing(height=0.4), targets)
    ours, _ = _rollout([standing(height=0.4)], [scene()], targets)
    np.testing.assert_allclose(ours.qpos[0], theirs, atol=2e-4)


def test_distance_walked_in_a_full_scene():
    """Boxes, a turned step and a tree, each a geom in C and a tangent plane in ours: the same trot gets as far."""
    things = [
        {"center": (0.9, -0.55, 0.5), "half": (0.1, 0.2, 0.5), "kind": OBSTACLE},
        {"center": (0.75, 0.0, 0.01), "half": (0.2, 1.0, 0.01), "yaw": 0.1, "kind": STEP},
        {"center": (2.2, 0.0, 0.5), "half": (0.1, 1.0, 0.5), "kind": OBSTACLE},
    ]
    full = scene(things, [{"center": (0.5, 0.6, 0.5), "radius": 0.1, "half_height": 0.5}])
    targets = trot_targets(100)
    theirs = c_rollout(scene_spec(full, A1).compile(), standing(), targets, *GAIT)
    ours, _ = _rollout([standing(), standing()], [full, scene()], targets, [_gait()])
    assert theirs[-1, 0] > 0.8
    assert ours.qpos[0, -1, 0] == pytest.approx(theirs[-1, 0], rel=0.1)
    assert np.abs(ours.qpos[0, :, 2] - theirs[:, 2]).mean() < 0.01
    # It is the step that makes the difference to flat ground.
    assert np.abs(ours.qpos[0, :, 2] - ours.qpos[1, :, 2]).max() > 0.01


def test_pushing_against_a_box_ends_where_it_does_in_c():
    box = scene([{"center": (0.7, 0.0, 0.5), "half": (0.1, 1.0, 0.5), "kind": OBSTACLE}])
    targets = trot_targets(60)
    theirs = c_rollout(scene_spec(box, A1).compile(), standing(), targets, *GAIT)
    ours, outcome = _rollout([standing()], [box], targets, [_gait()])
    assert outcome.obstacle_contact[0].any()
    assert abs(ours.qpos[0, -1, 0] - theirs[-1, 0]) < 0.05
    assert ours.qpos[0, -1, 0] < 0.7 - 0.1 - 0.05


def test_states_are_the_same_robot():
    """A guard for the tests above: the model the scenes are made of is the one that physics has."""
    state = initial_state(standing())
    model = flat_c_model()
    for ours, theirs in zip(links(compiled(A1)[1]).mass, links(model).mass, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert state.qpos.shape == (model.nq,) and state.qvel.shape == (model.nv,)
    assert jax.tree.leaves(state)[0].dtype == jp.float32


def test_hard_landings_on_rough_ground_are_cs_with_the_same_planes():
    """C's own prisms push a deep foot sideways: on the same ground they lead elsewhere."""
    worlds = [_rough(i) for i in range(world.BATCH)]
    velocity, targets = np.eye(18)[0] - 3.0 * np.eye(18)[2], world.still(5)
    starts = [standing(1.6, 0.3 * i - 0.5, 0.06 + A1.stand_height) for i in range(world.BATCH)]
    states = [PhysicsState(jp.asarray(q), jp.asarray(velocity, jp.float32), jp.zeros(18)) for q in starts]
    ours, _ = _rollout(states, worlds, targets, [_gait()] * world.BATCH)
    with_planes, with_prisms = [], []
    for found, start, one in zip(ours.qpos, starts, worlds, strict=True):
        c_model = scene_spec(one, A1).compile()
        for errors, step in ((with_planes, TerrainContacts(c_model).step), (with_prisms, None)):
            errors.append(np.abs(found - c_rollout(c_model, start, targets, *GAIT, qvel=velocity, step=step)))
    assert np.median(with_planes) < 5e-4  # the solver's iterations are those of training
    assert np.max(with_planes) < 0.02  # a triangle's edge is crossed a step sooner or later
    assert np.median(with_prisms) > 10 * np.median(with_planes)


def test_distance_walked_over_a_heightfield():
    """Blocks up to 5 cm high: C has the sphere meet every triangle it touches, ours the one beneath its centre.

    Single walks part after a stumble; their mean, and how high the trunk is carried, must not. (Over 48 walks
    the means are 0.403 m and, in C, 0.388 m; each spreads by 0.12 m.)
    """
    targets = trot_targets(60)
    ours, theirs = [], []
    for first in range(0, 3 * world.BATCH, world.BATCH):
        worlds = [_rough(first + i) for i in range(world.BATCH)]
        starts = []
        for i, one in enumerate(worlds):
            x, y = jp.float32(1.2), jp.float32(0.3 * i - 0.5)  # the ground is flat up to 1.2 m from the origin
            starts.append(standing(float(x), float(y), float(ground_height(one, x, y)) + A1.stand_height + 0.01))
        ours.append(_rollout(starts, worlds, targets, [_gait()])[0].qpos)
        theirs += [
            c_rollout(scene_spec(w, A1).compile(), s, targets, *GAIT) for w, s in zip(worlds, starts, strict=True)
        ]
    ours, theirs = np.concatenate(ours), np.stack(theirs)
    walked, expected = np.mean(ours[:, -1, 0]) - 1.2, np.mean(theirs[:, -1, 0]) - 1.2
    assert expected > 0.3
    assert walked == pytest.approx(expected, rel=0.1)
    np.testing.assert_allclose(ours[:, :, 2].mean(), theirs[:, :, 2].mean(), atol=0.005)
