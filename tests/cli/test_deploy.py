"""export and deploy: mistakes are one line and exit code 2."""

import pytest

from loco_mjx.cli.main import main
from loco_mjx.deploy import folder
from tests.deploy import flat


@pytest.fixture
def policy(tmp_path):
    (tmp_path / "policy").mkdir()
    return flat.write(tmp_path / "policy")


def refused(args, words, capsys):
    assert main(args) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and len(shown.err.splitlines()) == 1
    assert words in shown.err


def test_deploy_refuses(policy, tmp_path, capsys):
    refused(["deploy", str(tmp_path / "none")], "no policy folder", capsys)
    refused(["deploy", str(policy), "--task", "thn"], "'thin'", capsys)
    refused(["deploy", str(policy), "--scene", str(tmp_path / "none.xml")], "no scene", capsys)
    refused(["deploy", str(policy), "--seconds", "-1"], "seconds is -1", capsys)
    refused(["deploy", str(policy), "--robot", "spot"], "mujoco", capsys)
    (policy / folder.ONNX).write_bytes(b"something else")
    refused(["deploy", str(policy)], "is not the file", capsys)


def test_deploy_refuses_a_scene_without_the_robot(policy, tmp_path, capsys):
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    refused(["deploy", str(policy), "--scene", str(tmp_path / "empty.xml")], "no scene with an A1", capsys)


def test_export_refuses(tmp_path, capsys):
    refused(["export", str(tmp_path), "--out", str(tmp_path / "policy")], "no run in", capsys)
    assert not (tmp_path / "policy").exists()


def test_a_run_that_is_stopped_says_why(policy, tmp_path, capsys):
    (tmp_path / "scene.xml").write_text(flat._xml())
    words = ["deploy", str(policy), "--scene", str(tmp_path / "scene.xml"), "--seconds", "1"]
    assert main([*words, "--imperfections.dropped", "1", "--log", str(tmp_path / "run.npz")]) == 1
    assert "stale camera" in capsys.readouterr().out
    assert (tmp_path / "run.npz").is_file()
