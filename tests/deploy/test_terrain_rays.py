"""Rays on a heightfield's mesh end where C MuJoCo's rays on the heightfield itself end."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loco_mjx.deploy.mujoco_robot import GROUND_GROUP, SEEN_GROUP
from loco_mjx.deploy.terrain_rays import TerrainRays

SIZE = (1.5, 1.0, 0.8, 0.3)  # m: half widths, height of a 1, base
POSE = "pos='0.4 -0.2 0.1'"


def model_with_field(seed: int, pose: str = POSE) -> mujoco.MjModel:
    """A heightfield of single-cell spikes, shifted; and a box above it, which is no heightfield."""
    size = " ".join(map(str, SIZE))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><hfield name='h' nrow='17' ncol='26' size='{size}'/></asset><worldbody>
        <geom type='hfield' hfield='h' {pose} group='{SEEN_GROUP}'/>
        <geom type='box' size='0.1 0.1 0.1' pos='0.4 0.3 1.5' group='{SEEN_GROUP}'/></worldbody></mujoco>"""
    )
    random = np.random.default_rng(seed)
    model.hfield_data[:] = random.uniform(0, 0.4, 17 * 26) + 0.6 * (random.uniform(size=17 * 26) < 0.1)  # U, spikes
    return model


def cast(model: mujoco.MjModel, terrain: TerrainRays | None, origin: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Distance of every ray, m; infinite for none."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    groups = np.zeros(mujoco.mjNGROUP, np.uint8)
    groups[SEEN_GROUP] = 1
    hit, far = np.full(len(unit), -1, np.int32), np.zeros(len(unit))
    mujoco.mj_multiRay(model, data, origin, unit.ravel(), groups, True, -1, hit, far, None, len(unit), 1e6)
    if terrain is not None:
        terrain.nearest(origin, unit.ravel(), groups, hit, far)
    return np.where(hit >= 0, far, np.inf)


@pytest.mark.parametrize("pose", [POSE, POSE + " euler='0 20 30'"], ids=["level", "tilted"])
def test_the_mesh_is_the_heightfield(pose: str) -> None:
    random = np.random.default_rng(1)
    for seed in range(8):
        before, after = model_with_field(seed, pose), model_with_field(seed, pose)
        terrain = TerrainRays(after, SEEN_GROUP, GROUND_GROUP)
        origin = random.uniform([-3, -3, 0.1], [3, 3, 2])  # U: over the field, and outside, looking at its sides
        unit = random.uniform([-1.1, -1.2, 0], [1.9, 0.8, 0.8], (500, 3)) - origin  # U: toward points in its volume
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        expected, found = cast(before, None, origin, unit), cast(after, terrain, origin, unit)
        assert np.isfinite(expected).sum() > 300
        np.testing.assert_allclose(found, expected, atol=1e-5)
        box_only = cast(after, None, origin, unit)  # the heightfield has left the group of what is seen
        assert np.isfinite(box_only).sum() < np.isfinite(expected).sum() / 4


def test_no_heightfield_changes_nothing() -> None:
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><geom type='plane' size='9 9 1' group='{SEEN_GROUP}'/></worldbody></mujoco>"
    )
    terrain = TerrainRays(model, SEEN_GROUP, GROUND_GROUP)
    down = np.array([[0.0, 0.0, -1.0]])
    assert cast(model, terrain, np.array([0.0, 0.0, 2.0]), down) == pytest.approx([2.0])
    assert model.geom_group[0] == SEEN_GROUP
