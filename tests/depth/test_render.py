"""Images of single shapes, against distances worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jp
import numpy as np
import pytest
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from loco_mjx.config import DepthConfig
from loco_mjx.depth import primitives
from loco_mjx.depth.render import cast_rays, cull, gather, render
from loco_mjx.scene.types import Boxes, Cylinders, Scene, Spheres, Terrain
from tests.known_robots import A1

CONFIG = DepthConfig()
AHEAD = 0.2309  # the camera ahead of the base
HALF = np.sqrt(0.5)
HIGH = 20.0  # m, where the ground is out of sight
Rows = Sequence[Sequence[float]]
image_of = partial(render, mount=A1.camera, config=CONFIG)
see = jax.jit(image_of)


def make_scene(
    boxes: Rows = (), spheres: Rows = (), cylinders: Rows = (), collected: bool = False, terrain: Terrain | None = None
) -> Scene:
    """Boxes (x, y, z, hx, hy, hz, yaw), spheres (x, y, z, r), cylinders (x, y, z, r, half height)."""
    box, ball, trunk = (
        jp.array(rows, jp.float32).reshape(-1, width) for rows, width in ((boxes, 7), (spheres, 4), (cylinders, 5))
    )
    return Scene(
        boxes=Boxes(box[:, :3], box[:, 3:6], box[:, 6], jp.zeros((len(box), 2)), jp.zeros(len(box), jp.int32)),
        spheres=Spheres(ball[:, :3], ball[:, 3], jp.full(len(ball), collected), jp.ones(len(ball), bool)),
        cylinders=Cylinders(trunk[:, :3], trunk[:, 3], trunk[:, 4]),
        terrain=terrain,
        goal=jp.zeros(3),
    )


def at(x: float, y: float, z: float, quat: Sequence[float] = (1, 0, 0, 0)) -> jax.Array:
    """A base pose whose camera is at (x, y, z)."""
    w, i, j, k = quat
    forward = np.array([1 - 2 * (j * j + k * k), 2 * (i * j + w * k), 2 * (i * k - w * j)])
    return jp.array([*(np.array([x, y, z]) - AHEAD * forward), *quat], jp.float32)


def test_ground_of_a_level_camera() -> None:
    image = np.asarray(see(make_scene(), at(0, 0, 0.5)))
    assert image.shape == (64, 64) and image.dtype == np.float32
    assert (image[:33] == 10.0).all()  # the sky, and row 32: 0.5 / 0.00902 m = 55 m
    # row 40: up = -0.577350 · 17/64 = -0.153359; row 63: -0.568329; row 36: -0.577350 · 9/64 = -0.0811898
    np.testing.assert_allclose(image[[36, 40, 63], 5], [6.15841, 3.26033, 0.879772], rtol=1e-4)
    assert (np.ptp(image, axis=1) < 1e-4).all()


def test_ground_at_a_known_pitch() -> None:
    quat = (np.cos(np.pi / 12), 0, np.sin(np.pi / 12), 0)  # nose 30° down
    image = np.asarray(see(make_scene(), at(0, 0, 0.5, quat)))
    # A ray falls sin 30° - up · cos 30°: row 31: 0.5 - 0.0078125, row 63: 0.5 + 0.4921875, row 0: 0.0078125.
    np.testing.assert_allclose(image[[31, 63], 20], [0.5 / 0.4921875, 0.5 / 0.9921875], rtol=1e-5)
    assert image[0, 20] == 10.0


def test_roll_turns_the_image() -> None:
    image = np.asarray(see(make_scene(), at(0, 0, 0.5, (HALF, HALF, 0, 0))))  # left side up
    assert (image[:, :32] == 10.0).all()
    np.testing.assert_allclose(image[:, 63], 0.5 / 0.909310, rtol=1e-4)


def test_ground_is_not_seen_from_below() -> None:
    assert (np.asarray(see(make_scene(), at(0, 0, -0.5))) == 10.0).all()


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_box_face_is_flat_and_of_its_size(yaw: float) -> None:
    half = (0.5, 0.25, 0.125) if yaw == 0 else (0.25, 0.5, 0.125)
    image = np.asarray(see(make_scene(boxes=[(2.0 + half[1 if yaw else 0], 0, HIGH, *half, yaw)]), at(0, 0, HIGH)))
    hit = image < 10.0
    np.testing.assert_allclose(image[hit], 2.0, atol=1e-5)
    # Columns with |left| < 0.125: 0.923743 · n/64, n odd, up to n = 7 (0.101034); rows with |up| < 0.0625: up to n = 5.
    assert hit.sum() == 8 * 6 and hit[29:35, 28:36].all()


def test_turned_box_swaps_its_sides() -> None:
    boxes = [(2.5, 0, HIGH, 0.2, 0.5, 0.25, 0.0), (2.5, 0, HIGH, 0.5, 0.2, 0.25, np.pi / 2)]
    straight, turned = (np.asarray(see(make_scene(boxes=[box]), at(0, 0, HIGH))) for box in boxes)
    assert (straight < 10).sum() > 0
    np.testing.assert_allclose(straight, turned, atol=1e-4)


def test_box_on_its_edge() -> None:
    image = np.asarray(see(make_scene(boxes=[(3, 0, HIGH, 0.5, 0.5, 1, np.pi / 4)]), at(0, 0, HIGH)))
    # The edge is 3 - 0.707107 away, and the faces fall back as fast as they widen: t = 2.292893 + |left| t.
    np.testing.assert_allclose(image[31, [31, 32]], 2.292893 / (1 - 0.0144332), rtol=1e-5)
    np.testing.assert_allclose(image[31, 28], 2.292893 / (1 - 0.1010325), rtol=1e-5)


def test_sphere() -> None:
    image = np.asarray(see(make_scene(spheres=[(3, 0, HIGH, 0.5)]), at(0, 0, HIGH)))
    # a = 1 + left² + up² = 1.00028970; t = (3 - sqrt(9 - a · 8.75)) / a = (3 - 0.497459) / a
    np.testing.assert_allclose(image[31:33, 31:33], 2.501816, atol=2e-5)
    # Seen under asin(0.5 / 3): tangent 0.169031: columns up to n = 11 (0.158765), rows up to n = 17 (0.153359).
    assert (image[31] < 10).sum() == 12 and (image[:, 31] < 10).sum() == 18


def test_collected_sphere_is_not_seen() -> None:
    assert (np.asarray(see(make_scene(spheres=[(3, 0, HIGH, 0.5)], collected=True), at(0, 0, HIGH))) == 10.0).all()


def test_cylinder_side() -> None:
    image = np.asarray(see(make_scene(cylinders=[(3, 0, HIGH, 0.5, 0.25)]), at(0, 0, HIGH)))
    # a = 1 + left² = 1.00020832; t = (3 - sqrt(9 - a · 8.75)) / a = (3 - 0.498174) / a; the same in every row
    np.testing.assert_allclose(image[28:36, 31], 2.501305, atol=2e-5)
    # |up| · 2.5013 < 0.25: |up| < 0.0999: n up to 11
    assert (image[:, 31] < 10).sum() == 12


def test_cylinder_cap_from_above() -> None:
    down = (HALF, 0, HALF, 0)
    image = np.asarray(see(make_scene(cylinders=[(0, 0, 0.5, 0.5, 0.5)]), at(0, 0, 4, down)))
    # The cap is 3 m below, the ground 4 m; beside the cap, neither the far cap nor the side hides the ground.
    np.testing.assert_allclose(image[31, 31], 3.0, atol=1e-5)
    np.testing.assert_allclose(image[0, 0], 4.0, atol=1e-5)
    # |left| < 0.5 / 3 in row 31: sqrt(0.1666667² - 0.009²) = 0.166423: n up to 11
    assert (np.abs(image[31] - 3.0) < 1e-4).sum() == 12


@pytest.mark.parametrize("shape", ["boxes", "turned", "spheres", "cylinders"])
@pytest.mark.parametrize("distance", [0.6, 0.0])  # the surface 0.1 m ahead; the camera inside
def test_too_near_reads_near(shape: str, distance: float) -> None:
    rows = {
        "boxes": {"boxes": [(distance, 0, HIGH, 0.5, 2, 2, 0)]},
        "turned": {"boxes": [(distance, 0, HIGH, 0.5, 2, 2, 1e-3)]},
        "spheres": {"spheres": [(distance, 0, HIGH, 0.5)]},
        "cylinders": {"cylinders": [(distance, 0, HIGH, 0.5, 2)]},
    }[shape]
    image = np.asarray(see(make_scene(**rows), at(0, 0, HIGH)))
    np.testing.assert_allclose(image[31:33, 31:33], 0.3, atol=1e-6)


@pytest.mark.parametrize("shape", ["boxes", "spheres", "cylinders"])
def test_beyond_far_and_behind_read_far(shape: str) -> None:
    sizes = {"boxes": (1, 1, 1, 0), "spheres": (1,), "cylinders": (1, 1)}[shape]
    rows = [(11.5, 0, HIGH, *sizes), (-3, 0, HIGH, *sizes)]
    assert (np.asarray(see(make_scene(**{shape: rows}), at(0, 0, HIGH))) == 10.0).all()
    rows = [(10.5, 0, HIGH, *sizes)]  # its near side is in range
    assert np.asarray(see(make_scene(**{shape: rows}), at(0, 0, HIGH))).min() < 9.6


def test_nearest_of_many_wins_in_any_order() -> None:
    rng = np.random.default_rng(0)
    boxes = [(x, 0, HIGH, 0.1, 4, 4, yaw) for x, yaw in zip(np.arange(2, 9.5, 0.25), [0, 0.01] * 15, strict=True)]
    orders = [rng.permutation(30) for _ in range(3)]
    images = [np.asarray(see(make_scene(boxes=[boxes[i] for i in order]), at(0, 0, HIGH))) for order in orders]
    np.testing.assert_allclose(images[0], 1.9, atol=1e-5)
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_batches_equal_single_frames() -> None:
    keys = jax.random.split(jax.random.PRNGKey(0), 3)

    def scene(key: jax.Array) -> Scene:
        center = jax.random.uniform(key, (9, 3), minval=jp.array([1, -3, 0]), maxval=jp.array([9, 3, 1]))
        made = make_scene(boxes=[(0, 0, 0, 0.2, 0.3, 0.4, 0.5)] * 4 + [(0, 0, 0, 0.2, 0.3, 0.4, 0)] * 5)
        return made.replace(boxes=made.boxes.replace(center=center))

    scenes = jax.vmap(scene)(keys)
    poses = jp.stack([at(0, y, 0.4) for y in (-1.0, 0.0, 1.0)])
    single = [see(jax.tree.map(lambda leaf, i=i: leaf[i], scenes), poses[i]) for i in range(3)]
    np.testing.assert_allclose(jax.jit(jax.vmap(image_of))(scenes, poses), single, atol=1e-5)
    # one scene seen from several poses, one pose in several scenes, and two batch axes
    shared = jax.jit(jax.vmap(image_of, (None, 0)))(scene(keys[1]), poses)
    np.testing.assert_allclose(shared[1], single[1], atol=1e-5)
    shared = jax.jit(jax.vmap(image_of, (0, None)))(scenes, poses[2])
    np.testing.assert_allclose(shared[2], single[2], atol=1e-5)
    twice = jax.jit(jax.vmap(jax.vmap(image_of, (None, 0)), (0, None)))(scenes, poses)
    np.testing.assert_allclose(twice[0, 0], single[0], atol=1e-5)
    np.testing.assert_allclose(twice[1, 1], single[1], atol=1e-5)


def test_leaving_out_what_is_not_in_view_changes_no_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    place = np.column_stack([rng.uniform(-9, 12, 40), rng.uniform(-9, 9, 40), rng.uniform(HIGH - 6, HIGH + 6, 40)])
    size = rng.uniform(0.1, 1.5, (40, 3))
    scene = make_scene(
        boxes=np.column_stack([place, size, rng.uniform(-3, 3, 40) * (np.arange(40) % 2)])[:20],
        spheres=np.column_stack([place, size])[20:30, :4],
        cylinders=np.column_stack([place, size])[30:, :5],
    )
    quats = rng.normal(size=(24, 4))
    poses = jp.stack([at(0, 0, HIGH, quat / np.linalg.norm(quat)) for quat in quats])
    views = jax.jit(jax.vmap(partial(cull, mount=A1.camera, config=CONFIG), (None, 0)))(scene, poses)
    for shapes, number in ((views.boxes, 10), (views.turned_boxes, 10), (views.spheres, 10), (views.cylinders, 10)):
        assert 0 < shapes.count.mean() < 0.5 * number
    images = jax.jit(jax.vmap(image_of, (None, 0)))(scene, poses)
    for kind in ("boxes", "spheres", "cylinders"):
        monkeypatch.setattr(primitives, f"{kind}_in_view", lambda planes, shapes, center: jp.ones(len(center), bool))
    all_tested = jax.jit(jax.vmap(lambda pose: render(scene, pose, A1.camera, CONFIG)))(poses)
    assert float(jp.mean(images < CONFIG.far)) > 0.2
    # two programs: on some processors XLA joins multiplications and additions differently in them
    np.testing.assert_allclose(images, all_tested, atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_all_in_view_are_gathered_and_nothing_else(share: float) -> None:
    """Whatever their number, none is left out; they come in the scene's order, and the places after them are void."""
    rng = np.random.default_rng(4)
    center, half, flags = rng.normal(size=(30, 3)), rng.uniform(0.1, 1, (30, 3)), rng.uniform(size=30) < share
    shapes = gather(jp.asarray(flags), jp.asarray(center, jp.float32), jp.asarray(half, jp.float32))
    rows = np.asarray(shapes.params).reshape(-1, 6)
    assert len(rows) == 32 and shapes.count == flags.sum()
    np.testing.assert_array_equal(rows[: flags.sum()], np.column_stack([center, half])[flags].astype(np.float32))
    assert (rows[flags.sum() :, 3:] < 0).all()


def test_a_longer_scene_is_the_same_image_without_a_sort() -> None:
    """What stands beyond the far clip or behind changes no bit, and sorting, whose cost grows with it, is gone."""
    rng = np.random.default_rng(5)
    near, away = rng.uniform((1, -3, 0), (9, 3, 1), (20, 3)), rng.uniform((14, -3, 0), (70, 3, 1), (80, 3))
    away[::4, 0] -= 80

    def scene(place: np.ndarray) -> Scene:
        size = np.full((len(place), 3), 0.2)
        boxes = np.column_stack([place, size, 0.3 * (place[:, 2] > 0.5)])
        balls, trunks = (np.column_stack([place + np.array([0, shift, 0]), size]) for shift in (1, -1))
        return make_scene(boxes, balls[:, :4], trunks[:, :5])

    short, long = scene(near), scene(rng.permutation(np.concatenate([near, away])))
    pose = at(0, 0, 0.4)
    assert len(np.unique(see(short, pose))) > 200
    np.testing.assert_array_equal(see(short, pose), see(long, pose))
    assert "stablehlo.sort" not in jax.jit(partial(cull, mount=A1.camera, config=CONFIG)).lower(long, pose).as_text()


def test_all_frames_at_once_equal_single_frames() -> None:
    """What runs under ``jax.vmap`` on an accelerator, here on the CPU; frames differ in how much they see."""
    scene = make_scene(
        boxes=[(x, 1, 0.5, 0.2, 0.3, 0.5, 0.3 * (x % 2)) for x in range(1, 9)],
        spheres=[(4, 0, 0.2, 0.2)],
        cylinders=[(3, -1, 1, 0.2, 1)],
        terrain=Terrain(0.05 * jax.random.uniform(jax.random.PRNGKey(0), (120, 100)), (-1.0, -5.0), 0.1),
    )
    poses = jp.stack([at(x, 0, 0.4) for x in (-0.5, 2.5, 6.5)])
    views = jax.jit(jax.vmap(partial(cull, mount=A1.camera, config=CONFIG), (None, 0)))(scene, poses)
    assert len(set(np.asarray(views.boxes.count))) == 3
    in_turn = jax.jit(jax.vmap(image_of, (None, 0)))(scene, poses)
    at_once = jax.jit(jax.vmap(partial(cast_rays, config=CONFIG)))(views)
    np.testing.assert_allclose(at_once, in_turn, atol=1e-5)


@pytest.mark.parametrize("check_vma", [True, False])
def test_sharded_over_devices(check_vma: bool) -> None:
    scene = make_scene(boxes=[(3, 0, 0.5, 0.2, 0.3, 0.5, 0.0), (5, 1, 0.5, 0.2, 0.3, 0.5, 0.3)])
    poses = jp.stack([at(0, y, 0.4) for y in (-1.0, 1.0)])
    many = jax.vmap(image_of, (None, 0))
    mesh = Mesh(np.array(jax.devices()[:2]), ("shard",))
    split = jax.shard_map(many, mesh=mesh, in_specs=(P(), P("shard")), out_specs=P("shard"), check_vma=check_vma)
    np.testing.assert_allclose(jax.jit(split)(scene, poses), jax.jit(many)(scene, poses), atol=1e-6)


def test_a_broken_pose_stays_in_range() -> None:
    scene = make_scene([(3, 0, 1, 1, 1, 1, 0), (3, 0, 1, 1, 1, 1, 1)], [(3, 0, 1, 1)], [(3, 0, 1, 1, 1)])
    terrain = Terrain(jp.zeros((20, 20)), (-1.0, -1.0), 0.1)
    for world in (scene, scene.replace(terrain=terrain)):
        for broken in (jp.nan, jp.inf):
            image = np.asarray(see(world, jp.full(7, broken)))
            assert np.isfinite(image).all() and image.min() >= CONFIG.near and image.max() <= CONFIG.far


def test_seeds_of_frames_are_the_same_frames():
    """Two nested vmaps, as in training several seeds: every frame is what it is alone, crowded or not."""
    config = DepthConfig(height=8, width=8)
    rows = [
        [(2.0, 0.1 * i, 0.3, 0.2, 0.2, 0.3, 0.2 * i), (3.0, 0.0, 0.3, 0.1, 0.1, 0.3 * (i % 2), 0.0)] for i in range(6)
    ]
    scenes = [make_scene(boxes=row) for row in rows]
    qpos = jp.array([[0.05 * i, 0.0, 0.27, 1.0, 0.0, 0.0, 0.0] for i in range(6)], jp.float32)
    single = jax.jit(partial(render, mount=A1.camera, config=config))
    expected = np.stack([single(scene, pose) for scene, pose in zip(scenes, qpos, strict=True)])
    grid = jax.tree.map(lambda *leaves: jp.stack(leaves).reshape(2, 3, *leaves[0].shape), *scenes)
    found = jax.jit(jax.vmap(jax.vmap(partial(render, mount=A1.camera, config=config))))(grid, qpos.reshape(2, 3, 7))
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-5)
    assert len(np.unique(expected.reshape(6, -1), axis=0)) > 3
