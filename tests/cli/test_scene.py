from __future__ import annotations

import subprocess
import sys

import imageio.v3 as imageio
import mujoco
import pytest

from loco_mjx.cli.main import main
from loco_mjx.cli.scene import scene
from tests import optional
from tests.refusals import refusal, says


def test_writes_one_file_that_opens_by_itself(tmp_path):
    assert main(["scene", "--task", "stairs", "--seed", "4", "--out", str(tmp_path / "a.xml")]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    assert model.geom("step_3").group[0] == 2 and model.nkey == 1
    scene("stairs", 4, tmp_path / "b.xml")
    scene("stairs", 5, tmp_path / "c.xml")
    first, same, other = ((tmp_path / f"{name}.xml").read_text() for name in "abc")
    assert first == same != other


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--task", "stair", "--out", "x.xml"], "stair stairs"),
        (["--seed", "-1", "--out", "x.xml"], "seed -1 0 4294967295"),
        ([], "--out --png"),
        (["--out", "missing/x.xml"], "directory missing"),
        (["--out", "."], "'.' directory"),
        (["--out", "x.xml", "--png", "missing/x.png"], "directory missing"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing_behind(args, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["scene", *args]) == 2
    said = capsys.readouterr().err
    assert says(said, words) and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_without_opengl_the_mjcf_is_written_all_the_same(tmp_path, monkeypatch):
    def no_context(*_, **__):
        raise RuntimeError("no context")

    monkeypatch.setattr(mujoco, "Renderer", no_context)
    with refusal("--png OpenGL libegl1"):
        scene("stairs", 0, tmp_path / "a.xml", tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.xml"]


@optional.needs_opengl
def test_picture(tmp_path):
    """In a process of its own, for MuJoCo picks its OpenGL when it is imported."""
    command = [sys.executable, "-m", "loco_mjx.cli.main", "scene", "--task", "stairs"]
    command += ["--robot", "go2", "--png", str(tmp_path / "a.png")]
    done = subprocess.run(command, capture_output=True, text=True)
    optional.skip_without_driver(done.stderr)
    assert done.returncode == 0, done.stderr
    image = imageio.imread(tmp_path / "a.png")
    assert image.shape[0] > 300 and image.shape[1] > 800
    left, right = image[:, : image.shape[1] // 2, :3], image[:, image.shape[1] // 2 :, :3]
    assert left.std() > 20 and right.std() > 20
