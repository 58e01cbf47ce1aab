"""The camera's pose and rays, against numbers worked out by hand."""

from __future__ import annotations

import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.depth import camera
from tests.known_robots import A1

HALF = np.sqrt(0.5)


def test_pose_unturned_is_ahead_along_x() -> None:
    origin, rotation = camera.pose(jp.array([1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 9.0]), A1.camera)
    np.testing.assert_allclose(origin, [1.2309, 2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-6)


@pytest.mark.parametrize(
    ("quat", "forward", "left", "up"),
    [
        ((HALF, 0, 0, HALF), (0, 1, 0), (-1, 0, 0), (0, 0, 1)),  # yaw +90°
        ((HALF, 0, HALF, 0), (0, 0, -1), (0, 1, 0), (1, 0, 0)),  # pitch +90°: nose down
        ((HALF, HALF, 0, 0), (1, 0, 0), (0, 0, 1), (0, -1, 0)),  # roll +90°: left side up
    ],
)
def test_pose_turned(quat: tuple, forward: tuple, left: tuple, up: tuple) -> None:
    origin, rotation = camera.pose(jp.array([0.0, 0.0, 1.0, *quat]), A1.camera)
    np.testing.assert_allclose(np.asarray(rotation).T, [forward, left, up], atol=1e-6)
    np.testing.assert_allclose(origin, np.array([0, 0, 1]) + 0.2309 * np.array(forward), atol=1e-6)


def test_pose_ignores_the_quaternions_length() -> None:
    quat = np.array([0.9, 0.1, -0.2, 0.3])
    long, unit = (camera.pose(jp.array([0, 0, 0, *q]), A1.camera) for q in (3 * quat, quat / np.linalg.norm(quat)))
    np.testing.assert_allclose(long[0], unit[0], atol=1e-6)
    np.testing.assert_allclose(long[1], unit[1], atol=1e-6)


def test_rays_at_centre_and_edges() -> None:
    left, up = (component.reshape(64, 64) for component in camera.rays(DepthConfig()))
    # Pixel centres: the outermost is half a pixel, 1/64 of the half image, inside tan(85.46°/2) = 0.923743.
    np.testing.assert_allclose(left[0, [0, 31, 32, 63]], [0.909310, 0.0144332, -0.0144332, -0.909310], atol=1e-5)
    # tan(30°) = 0.577350
    np.testing.assert_allclose(up[[0, 31, 32, 63], 0], [0.568329, 0.00902110, -0.00902110, -0.568329], atol=1e-6)
    assert np.ptp(left, axis=0).max() == 0 and np.ptp(up, axis=1).max() == 0
    np.testing.assert_allclose(np.diff(left[0]), left[0, 1] - left[0, 0], atol=1e-6)


def test_rays_of_another_size() -> None:
    left, up = camera.rays(DepthConfig(height=1, width=2, horizontal_fov=90.0))
    np.testing.assert_allclose(left, [0.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(up, [0.0, 0.0], atol=1e-6)
