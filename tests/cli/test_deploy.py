"""export and deploy: mistakes are one line and exit code 2."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.deploy import folder
from loco_mjx.deploy.mujoco_robot import MujocoRobot
from loco_mjx.deploy.safety import Cause
from tests.deploy import flat
from tests.deploy.test_runner import BROKEN
from tests.refusals import clear, says


@pytest.fixture
def policy(tmp_path):
    (tmp_path / "policy").mkdir()
    return flat.write(tmp_path / "policy")


def refused(args, words, capsys):
    assert main(args) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and clear(shown.err)
    assert says(shown.err, words), shown.err


def test_deploy_refuses(policy, tmp_path, capsys):
    refused(["deploy", str(tmp_path / "none")], f"{tmp_path}/none export", capsys)
    refused(["deploy", str(policy), "--task", "thn"], "thn thin", capsys)
    refused(["deploy", str(policy), "--scene", str(tmp_path / "none.xml")], f"{tmp_path}/none.xml scene", capsys)
    refused(["deploy", str(policy), "--seconds", "-1"], "seconds -1.0 3600", capsys)
    refused(["deploy", str(policy), "--robot", "spot"], "spot mujoco a1", capsys)
    (policy / folder.ONNX).write_bytes(b"something else")
    refused(["deploy", str(policy)], f"{folder.ONNX} {folder.MANIFEST}", capsys)


def test_deploy_refuses_a_controller_that_cannot_walk(policy, capsys):
    refused(["deploy"], "policy export --controller", capsys)
    refused(["deploy", str(policy), "--controller", "mpc"], "--controller mpc policy", capsys)
    refused(["deploy", str(policy), "--vx", "0.2"], "--vx --controller mpc", capsys)
    refused(["deploy", "--controller", "mpc", "--vx", "nan"], "vx nan -10 10", capsys)
    refused(["deploy", "--controller", "mpc", "--robot", "a1", "--body", "go1"], "--robot a1 --body", capsys)


def test_deploy_refuses_a_scene_without_the_robot(policy, tmp_path, capsys):
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    refused(["deploy", str(policy), "--scene", str(tmp_path / "empty.xml")], "robot scene", capsys)


def test_export_refuses(tmp_path, capsys):
    refused(["export", str(tmp_path), "--out", str(tmp_path / "policy")], f"{tmp_path} run train", capsys)
    assert not (tmp_path / "policy").exists()


def test_a_run_that_is_stopped_says_why(policy, tmp_path, capsys):
    (tmp_path / "scene.xml").write_text(flat.xml())
    words = ["deploy", str(policy), "--scene", str(tmp_path / "scene.xml"), "--seconds", "1"]
    assert main([*words, "--imperfections.dropped", "1", "--log", str(tmp_path / "run.npz")]) == 1
    assert str(Cause.STALE_CAMERA) in capsys.readouterr().out
    assert (tmp_path / "run.npz").is_file()


SCENE_SECONDS = 3600  # of simulated time: far longer than any test waits


@contextlib.contextmanager
def running(policy, tmp_path, stdin=subprocess.DEVNULL, more=()):
    """A deploy process whose policy has begun to run."""
    (tmp_path / "scene.xml").write_text(flat.xml())
    words = ["deploy", str(policy), "--scene", str(tmp_path / "scene.xml"), "--seconds", str(SCENE_SECONDS)]
    command = [sys.executable, "-m", "loco_mjx.cli.main", *words, "--limits.missed", "100", *more]
    process = subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, text=True)
    try:
        for line in process.stdout:
            if "running" in line:
                break
        yield process
    finally:
        process.kill()
        process.wait()


def sits_down(process, by):
    rest, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert says(rest, f"emergency {by}")
    assert rest.index(Cause.ESTOP) < rest.index("done")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_to_the_process_is_an_emergency_stop(number, policy, tmp_path):
    with running(policy, tmp_path) as process:
        process.send_signal(number)
        sits_down(process, number.name)


def test_enter_on_the_terminal_is_an_emergency_stop(policy, tmp_path):
    ours, its = os.openpty()
    with running(policy, tmp_path, its) as process:
        os.close(its)
        os.write(ours, b"\n")
        sits_down(process, "Enter")
    os.close(ours)


class Recording(MujocoRobot):
    """Counts the commands that any robot gets."""

    commands = 0

    def command(self, targets, kp, kd):
        Recording.commands += 1
        super().command(targets, kp, kd)


def _cut(path):
    path.write_bytes(path.read_bytes()[:40])


DAMAGE = {name: lambda path, changes=changes: flat.write(path, changes) for name, (changes, _) in BROKEN.items()} | {
    "no folder": shutil.rmtree,
    "no manifest": lambda path: (path / folder.MANIFEST).unlink(),
    "no onnx": lambda path: (path / folder.ONNX).unlink(),
    "half a manifest": lambda path: _cut(path / folder.MANIFEST),
    "half an onnx": lambda path: _cut(path / folder.ONNX),
    "not onnx, but as described": lambda path: flat.write(path, content=b"no model"),
}


def test_no_robot_is_commanded_by_a_broken_folder(policy, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("loco_mjx.cli.deploy.MujocoRobot", Recording)
    monkeypatch.setattr(Recording, "commands", 0)
    (tmp_path / "scene.xml").write_text(flat.xml())
    words = ["deploy", str(policy), "--scene", str(tmp_path / "scene.xml"), "--seconds", "0.1"]
    for name, damage in DAMAGE.items():
        damage(policy)
        assert main(words) == 2, name
        assert len(capsys.readouterr().err.splitlines()) == 1, name
        assert Recording.commands == 0, name
        policy.mkdir(exist_ok=True)
        flat.write(policy)
    assert main([*words, "--limits.missed", "100"]) == 0
    assert Recording.commands > 100


def test_a_hang_up_with_nobody_reading_is_an_emergency_stop(policy, tmp_path):
    log = ["--log", str(tmp_path / "run.npz")]
    with running(policy, tmp_path, more=log) as process:
        process.stdout.close()
        process.send_signal(signal.SIGHUP)
        process.wait(timeout=60)
    about = json.loads(str(np.load(tmp_path / "run.npz")["about"]))
    assert (about["cause"], about["detail"]) == (Cause.ESTOP, "SIGHUP")
    assert about["events"][-1][1] == "done"
