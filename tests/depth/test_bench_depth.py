"""The benchmark runs, and its robots stand where it says."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
import pytest

from loco_mjx.bench.depth import bench_depth, standing_poses
from loco_mjx.errors import UnknownNameError
from loco_mjx.scene.pool import make_pool
from loco_mjx.scene.tasks import get_task
from tests.known_robots import A1


def test_bench_measures_both() -> None:
    result = bench_depth("stairs", num_envs=3, seconds=0.0)
    assert set(result) == {"per_second", "unit", "compile_seconds", "num_envs", "devices", "peer"}
    assert result["num_envs"] == 3 and result["devices"] == 1  # 3 does not divide over the tests' 2 devices
    assert result["peer"]["name"] == "mj_multiRay" and result["peer"]["threads"] == 1
    assert result["per_second"] > 0 and result["peer"]["per_second"] > 0


def test_bench_refuses_an_unknown_task() -> None:
    with pytest.raises(UnknownNameError):
        bench_depth("thinn", num_envs=1, seconds=0.0)


def test_robots_stand_on_the_steps() -> None:
    key = jax.random.PRNGKey(0)
    poses = np.asarray(jax.jit(partial(standing_poses, A1))(key, make_pool(key, get_task("stairs"), 64)))
    steps = (poses[:, 2] - A1.stand_height) / 0.1
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    assert set(np.round(steps)) == {0, 1, 2, 3, 4}
    assert poses[:, 0].min() > 0 and poses[:, 0].max() < 18 and np.abs(poses[:, 1]).max() <= 1
