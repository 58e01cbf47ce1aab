"""A run's configuration names its robot, and starts from that robot's own gains."""

from __future__ import annotations

import dataclasses

import pytest

from loco_mjx.cli import train
from loco_mjx.cli.main import main
from loco_mjx.config import Config, check, from_dict, preset, to_dict, with_robot
from loco_mjx.config.keys import with_keys
from tests.known_robots import GO1, GO2
from tests.refusals import refusal, says


def test_a_robots_gains_are_its_configurations():
    config = preset("fast", "go1")
    assert (config.env.robot, config.env.kp, config.env.kd) == ("go1", GO1.kp, GO1.kd)
    assert config.env.action.scale == (0.2, 0.5, 0.5)  # the preset's own, not the robot's
    assert dataclasses.replace(with_robot(config, "a1"), env=preset("fast").env) == preset("fast")
    chosen = dataclasses.replace(Config(), env=dataclasses.replace(Config().env, kp=55.0))
    assert with_robot(chosen, "go1").env.kp == 55.0 and with_robot(chosen, "go1").env.kd == GO1.kd


@pytest.mark.parametrize("words", (["--robot", "go1"], ["--env.robot", "go1"], ["--robot=go1"]))
def test_the_command_line_starts_from_the_robots_gains(words):
    options = train.read(["--policy", "state-only", *words])
    config = train.configuration(options)
    assert (config.env.robot, config.env.kp) == ("go1", GO1.kp)
    given = train.configuration(train.read([*words, "--env.kp", "60"]))
    assert (given.env.kp, given.env.kd) == (60.0, GO1.kd)
    assert train.planned(options, words, config)[0].directory.parts[:2] == ("runs", "go1")


def test_a_sweeps_change_of_robot_brings_its_gains():
    changed = with_keys(preset("fast"), [("env.kd", "0.9"), ("env.robot", "go1")])
    assert (changed.env.robot, changed.env.kp, changed.env.kd) == ("go1", GO1.kp, 0.9)


def test_a_configuration_of_before_there_were_robots_is_an_a1s():
    written = to_dict(Config())
    del written["env"]["robot"]
    assert from_dict(Config, written).env.robot == "a1"


@pytest.mark.parametrize("command", ("train", "scene", "bench", "play"))
def test_unknown_robots_are_refused_in_one_line(command, capsys, tmp_path):
    words = {
        "train": ["--policy", "state-only", "--out", str(tmp_path / "run")],
        "scene": ["--out", str(tmp_path / "a.xml")],
        "bench": ["physics"],
        "play": ["--zero", "--video", str(tmp_path / "a.mp4")],
    }
    assert main([command, *words[command], "--robot", "go3"]) == 2
    said = capsys.readouterr().err
    assert says(said, "robot go3 go2") and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_robot_that_does_not_fit_is_refused_before_anything_is_written(tmp_path, capsys):
    path = tmp_path / "mine.xml"
    path.write_text(GO2.path.read_text().replace('<site name="imu"', '<site name="sensor"'))
    out = tmp_path / "run"
    assert main(["train", "--policy", "state-only", "--robot", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert says(said, f"{path} site imu") and said.count("\n") == 1 and not out.exists()
    with refusal(f"{path} site imu"):
        check(dataclasses.replace(Config(), env=dataclasses.replace(Config().env, robot=str(path))))
