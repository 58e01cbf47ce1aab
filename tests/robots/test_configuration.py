"""A run's configuration names its robot, and starts from that robot's own gains."""

from __future__ import annotations

import dataclasses

import pytest

from loco_mjx.cli import train
from loco_mjx.cli.main import main
from loco_mjx.config import Config, check, from_dict, preset, to_dict, with_robot
from loco_mjx.config.keys import with_keys
from tests.known_robots import A1, GO1, GO2
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


def test_what_is_measured_late_is_no_older_than_a_control_step(tmp_path):
    """Of a robot of 50 Hz half as old as of one of 25; older is refused."""
    text = A1.path.read_text()
    assert 'name="policy_hz" data="25"' in text
    (tmp_path / "mine.xml").write_text(text.replace('name="policy_hz" data="25"', 'name="policy_hz" data="50"'))
    mine = preset("real", robot=str(tmp_path / "mine.xml"))
    assert mine.env.randomization.latency == (0.0, 0.02) and preset("real").env.randomization.latency == (0.0, 0.04)
    check(mine)
    late = dataclasses.replace(mine.env.randomization, latency=(0.0, 0.03))
    with refusal("env.randomization.latency 0.03 0.02"):
        check(dataclasses.replace(mine, env=dataclasses.replace(mine.env, randomization=late)))


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
