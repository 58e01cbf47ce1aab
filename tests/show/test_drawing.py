from __future__ import annotations

import os
import subprocess
import warnings

import imageio.v3 as imageio
import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx.config import DepthConfig
from loco_mjx.networks.encoders import DepthEncoder, VisualTokens
from loco_mjx.scene.mjcf import scene_spec
from loco_mjx.scene.tasks import get_task
from loco_mjx.show import drawing, meshes, video
from tests.known_robots import A1
from tests.refusals import refusal

DEPTH = DepthConfig()


@pytest.mark.parametrize("side", [2, 4])
def test_attention_lies_over_what_its_token_sees(side):
    """What only one corner token's receptive field holds changes that token alone, and there the heat is."""
    encoder, projection = DepthEncoder((8, 8, 8)), VisualTokens(4, side)
    image = jp.zeros((64, 64, 4))
    encoding = jax.jit(encoder.init)(jax.random.PRNGKey(0), image)
    tokening = jax.jit(projection.init)(jax.random.PRNGKey(1), jp.zeros((4, 4, 8)))
    tokens = jax.jit(lambda image: projection.apply(tokening, encoder.apply(encoding, image)))
    before = tokens(image)
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        # A feature sees 36 pixels, 8 further than the one before it: the last one sees 24 to 59.
        where = np.s_[52 * row : 52 * row + 8, 52 * column : 52 * column + 8]
        change = np.abs(tokens(image.at[where].set(1.0)) - before).sum(-1)
        assert np.count_nonzero(change) == 1
        spread = drawing.heat(change, 64, 64)
        top = np.unravel_index(spread.argmax(), spread.shape)
        assert (top[0] // 32, top[1] // 32) == (row, column)


def test_heat_keeps_what_it_is_given():
    spread = drawing.heat(np.full(16, 0.05), 64, 48)
    assert spread.shape == (64, 48)
    np.testing.assert_allclose(spread, 0.05)  # even attention is even heat
    np.testing.assert_allclose(drawing.heat(np.arange(4.0), 2, 2), [[0, 1], [2, 3]])
    assert drawing.heat(np.array([0.3]), 5, 5).min() == pytest.approx(0.3)


def test_overlay_leaves_the_unattended_alone():
    depth = np.full((64, 64), 3.0)
    grey = drawing.depth_picture(depth, DEPTH, grey=True)
    shown = drawing.overlay(depth, np.eye(16)[0], DEPTH)
    np.testing.assert_array_equal(shown[32:], grey[32:])
    red, _, blue = shown[4, 4].astype(int)
    assert red > blue + 50


def test_attention_has_one_scale_for_all_frames():
    """Uniform attention shows nothing; the same attention looks the same whatever else the frame holds."""
    depth = np.full((64, 64), 3.0)
    grey = drawing.depth_picture(depth, DEPTH, grey=True)
    for tokens in (1, 4, 16):
        uniform = np.full(tokens, 1 / (tokens + 1))
        np.testing.assert_array_equal(drawing.overlay(depth, uniform, DEPTH), grey)
    rng = np.random.default_rng(0)
    nearly = np.full(16, 1 / 17) * rng.uniform(0.8, 1.2, 16)  # as a policy that has learnt nothing
    assert np.abs(drawing.overlay(depth, nearly, DEPTH).astype(int) - grey).max() < 20
    alone, beside = np.zeros(16), np.zeros(16)
    alone[0] = beside[0] = 2 / 17
    beside[15] = 15 / 17
    pictures = [drawing.overlay(depth, attention, DEPTH) for attention in (alone, beside)]
    np.testing.assert_array_equal(pictures[0][:32, :32], pictures[1][:32, :32])
    assert np.any(pictures[1][-1, -1] != pictures[0][-1, -1])


def test_the_scale_shows_the_colours_of_the_overlay_and_its_label():
    bar = drawing.scale(205)
    middle = np.full(3, 0.5)
    np.testing.assert_array_equal(bar[0, 0], [128, 128, 128])  # uniform attention: what is under it
    np.testing.assert_allclose(bar[0, -1] / 255.0, drawing.attended(np.array([drawing.TOP]), middle)[0], atol=0.01)
    assert (bar[-15:] < 80).any() and bar.shape[1:] == (205, 3)  # letters
    view = np.zeros((180, 320, 3), np.uint8)
    rows, columns = drawing.inset_box(view.shape[:2], drawing.aspect(DEPTH))
    shown = drawing.with_scale(view, drawing.aspect(DEPTH))
    np.testing.assert_array_equal(shown[rows.stop + 1, columns], drawing.scale(columns.stop - columns.start)[0])
    assert not shown[: rows.stop].any() and not shown[:, columns.stop :].any() and not view.any()


def test_a_figure_with_attention_has_its_scale(tmp_path):
    picture = np.zeros((18, 32, 3), np.uint8)
    for name in ("depth", video.ATTENTION):
        video.strip([("view", [picture]), (name, [picture])], [0.0], 1.6, tmp_path / f"{name}.svg")
    texts = [(tmp_path / f"{name}.svg").read_text() for name in ("depth", video.ATTENTION)]
    assert [drawing.LABEL in text for text in texts] == [False, True]  # matplotlib comments its glyphs with the text


def test_near_is_bright():
    picture = drawing.depth_picture(np.array([[0.3, 10.0, 20.0]]), DEPTH).sum(-1)
    assert picture[0, 0] > picture[0, 1] == picture[0, 2]


def test_inset_is_at_the_upper_left_and_the_rest_untouched():
    view = np.zeros((180, 320, 3), np.uint8)
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32, 32:] = (255, 0, 0)  # its upper right
    out = drawing.with_inset(view, image, drawing.aspect(DEPTH))
    rows, columns = drawing.inset_box((180, 320), drawing.aspect(DEPTH))
    assert (rows.start, columns.start, columns.stop - columns.start) == (6, 6, 102)
    assert rows.stop - rows.start == 64  # 102 / (tan 42.73° / tan 30°)
    assert tuple(out[rows.start + 2, columns.stop - 3]) == (255, 0, 0)
    assert not out[rows.stop - 3, columns.stop - 3].any()
    out[rows.start - 1 : rows.stop + 1, columns.start - 1 : columns.stop + 1] = 0
    assert not out.any() and not view.any()


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_can_be_read_back(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    with video.writer(path, 36, 64, 25.0) as add:
        for index in range(10):
            frame = np.zeros((36, 64, 3), np.uint8)
            frame[:, 6 * index : 6 * index + 6] = 250
            add(frame)
        assert not path.exists()
    film = imageio.imread(path)
    assert film.shape[:3] == (10, 36, 64)
    assert [int(frame[..., :3].sum((0, 2)).argmax()) // 6 for frame in film.astype(int)] == list(range(10))
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_film_forks_nothing(tmp_path):
    """A fork while JAX's threads run may deadlock; JAX warns of each. Programs are started without one."""
    forks = []
    os.register_at_fork(before=lambda: forks.append(1))
    with video.writer(tmp_path / "a.gif", 36, 64, 25.0) as add:
        add(np.zeros((36, 64, 3), np.uint8))
    assert not forks
    with warnings.catch_warnings(action="ignore"):
        subprocess.run(["true"], preexec_fn=os.getpid, check=True)
    assert forks  # the hook hears what it should


def test_what_ffmpeg_complains_of_is_one_line(tmp_path):
    with (
        refusal(f"{tmp_path / 'a.mp4'} divisible") as error,
        video.writer(tmp_path / "a.mp4", 37, 63, 25.0) as add,
    ):
        add(np.zeros((37, 63, 3), np.uint8))
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


def test_a_film_that_breaks_off_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), video.writer(tmp_path / "a.mp4", 36, 64, 25.0) as add:
        add(np.zeros((36, 64, 3), np.uint8))
        raise RuntimeError
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("task", ["thin-sphere", "mountain", "forest"])
def test_triangles_are_the_geoms(task):
    """A ray hits the triangles where C MuJoCo's hits the geom, in the frame of the geom's body."""
    model = scene_spec(jax.jit(get_task(task).generate)(jax.random.PRNGKey(0)), A1).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    kinds = {}
    for geom in range(model.ngeom):
        if model.geom_group[geom] in meshes.SEEN_GROUPS and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            kinds.setdefault(int(model.geom_type[geom]), geom)
    for geom in kinds.values():
        mesh, body = meshes.mesh(model, geom), model.geom_bodyid[geom]
        place = mesh.vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        middle = data.geom_xpos[geom] + [0.003, 0.004, 0.0]
        above = np.array([middle[0], middle[1], place[:, 2].max() + 1.0])
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
            above[:2] = place[place[:, 2].argmax(), :2]  # the summit is a vertex
            assert mujoco.mj_rayHfield(model, data, geom, above, [0.0, 0, -1], None) == pytest.approx(1.0, abs=1e-3)
            continue
        hit = mujoco.mju_rayGeom(
            data.geom_xpos[geom],
            data.geom_xmat[geom],
            model.geom_size[geom],
            above,
            np.array([0.0, 0, -1]),
            int(model.geom_type[geom]),
            None,
        )
        moved = mesh.copy()
        moved.vertices = place
        ours = moved.ray.intersects_location([above], [[0.0, 0, -1]])[0]
        assert above[2] - ours[:, 2].max() == pytest.approx(hit, abs=4e-3)
