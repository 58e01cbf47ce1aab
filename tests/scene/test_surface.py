from __future__ import annotations

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.scene import surface
from loco_mjx.scene.parts import make_boxes, make_scene
from loco_mjx.scene.surface import ground_height
from loco_mjx.scene.types import OBSTACLE, STEP, Terrain

ground = jax.jit(surface.ground)
# Vertex (i, j) is at (1 + 0.5 i, -1 + 0.5 j).
TERRAIN = Terrain(jp.array([[0.0, 4.0, 0.0], [1.0, 2.0, 0.0]]), origin=(1.0, -1.0), cell=0.5)


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (1.0, -1.0, (0.0, None, None)),
        (1.25, -0.75, (1.0, None, None)),  # on the diagonal from (0, 0) to (1, 1): between 0 and 2
        (1.4, -0.9, (0.8 * 1 + 0.2 * 1, 2.0, 2.0)),  # in 0, 1, 2: rises of 1 along x, then 1 along y
        (1.1, -0.6, (0.8 * 4 - 0.2 * 2, -4.0, 8.0)),  # in 0, 4, 2: rises of 4 along y, then −2 along x
        (1.5, -0.25, (1.0, None, None)),  # on an edge, between 2 and 0
    ],
)
def test_by_hand(x, y, expected):
    found = ground(TERRAIN, jp.float32(x), jp.float32(y))
    for value, wanted in zip(found, expected, strict=True):
        assert wanted is None or float(value) == pytest.approx(wanted, abs=1e-5)


def test_outside_the_border_goes_on_level_across_it():
    height, slope_x, slope_y = ground(TERRAIN, jp.array([5.0, -3.0, 1.4, 9.0]), jp.array([-0.75, -0.5, -9.0, 9.0]))
    np.testing.assert_allclose(height, [1.5, 4.0, 0.8, 0.0], atol=1e-5)
    np.testing.assert_allclose(slope_x, [0.0, 0.0, 2.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(slope_y[jp.array([0, 2, 3])], [2.0, 0.0, 0.0], atol=1e-5)


def test_no_heightfield_is_the_plane_of_zero_height():
    x = jp.linspace(-3, 3, 12).reshape(3, 4)
    for value in ground(None, x, x):
        assert value.shape == x.shape and value.dtype == x.dtype and not value.any()


def test_slopes_are_the_derivative_of_the_height():
    key_heights, key_x, key_y = jax.random.split(jax.random.PRNGKey(0), 3)
    terrain = Terrain(jax.random.uniform(key_heights, (9, 7)), origin=(-2.0, 1.0), cell=0.5)
    x = jax.random.uniform(key_x, (200,), minval=-2.0, maxval=2.0)
    y = jax.random.uniform(key_y, (200,), minval=1.0, maxval=4.0)
    rise_x, rise_y = jax.jit(jax.vmap(jax.grad(lambda x, y: ground(terrain, x, y)[0], argnums=(0, 1))))(x, y)
    _, slope_x, slope_y = ground(terrain, x, y)
    np.testing.assert_allclose(slope_x, rise_x, atol=1e-4)
    np.testing.assert_allclose(slope_y, rise_y, atol=1e-4)


def test_a_lost_robot_reads_nothing_out_of_bounds():
    height, slope_x, _ = ground(TERRAIN, jp.array([jp.nan, jp.inf]), jp.array([jp.nan, -jp.inf]))
    assert height.shape == slope_x.shape == (2,) and np.isfinite(height[1])


def test_one_stands_on_steps_and_not_on_obstacles():
    center, half = jp.array([[2.0, 0.0, 0.2]]), jp.array([0.5, 0.3, 0.3])
    step = make_scene(make_boxes(center, half, STEP, yaw=jp.array([jp.pi / 2])))
    on = lambda scene, x, y: float(jax.jit(ground_height)(scene, jp.float32(x), jp.float32(y)))  # noqa: E731
    assert on(step, 2.0, 0.45) == pytest.approx(0.5)  # turned: long side along y
    assert on(step, 2.45, 0.0) == 0.0
    assert on(make_scene(make_boxes(center, half, OBSTACLE)), 2.0, 0.0) == 0.0
    assert on(make_scene(ground_field=TERRAIN), 1.25, -0.75) == pytest.approx(1.0)
    higher = make_scene(make_boxes(jp.array([[1.25, -0.75, 0.0]]), half, STEP), ground_field=TERRAIN)
    assert on(higher, 1.25, -0.75) == pytest.approx(1.0)  # the ground is above the step
