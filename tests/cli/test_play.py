from __future__ import annotations

import pytest

from loco_mjx.cli.main import main
from loco_mjx.cli.play import RATES, pace
from tests.refusals import says


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--zero"], "--video --figure --web"),
        (["--video", "a.mp4"], "policy --zero --random --controller"),
        (["--zero", "--random", "--video", "a.mp4"], "--zero --random"),
        (["--zero", "--video", "a.avi"], "a.avi .mp4 .gif"),
        (["--zero", "--figure", "a.mp4"], "a.mp4 .png .svg"),
        (["--zero", "--video", "missing/a.mp4"], "directory missing"),
        (["--zero", "--video", "old.gif"], "old.gif exists --overwrite"),
        (["--zero", "--video", "a.gif", "--fps", "24"], "fps 24.0 25.0 12.5 5.0"),
        (["--zero", "--video", "a.gif", "--seconds", "0"], "seconds 0.0"),
        (["--zero", "--video", "a.gif", "--task", "thick"], "task thick thin"),
        (["--zero", "--web", "--video", "a.gif"], "--web --video --figure"),
        (["--zero", "--attention", "--video", "a.gif"], "zero attention loco-transformer"),
        (["nowhere", "--video", "a.gif"], "run nowhere"),
        (["--zero", "--web", "--port", "0"], "port 0"),
        (["--controller", "mpc", "--zero", "--video", "a.gif"], "--controller mpc --zero"),
        (["--controller", "mpc", "--web"], "--web --controller --video"),
        (["--controller", "mpc", "--vx", "nan", "--video", "a.gif"], "vx nan -10 10"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing_behind(args, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.gif").write_text("old")
    assert main(["play", *args]) == 2
    said = capsys.readouterr().err
    assert says(said, words) and said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["old.gif"]
    assert (tmp_path / "old.gif").read_text() == "old"


@pytest.mark.parametrize(
    ("rate", "fps", "found"),
    [(25, 12.5, (2, 12.5)), (50, 25.0, (2, 25.0)), (50, 5.0, (10, 5.0)), (40, 25.0, (2, 20.0)), (10, 25.0, (1, 10.0))],
)
def test_a_film_is_in_real_time_whatever_the_robots_rate(rate, fps, found):
    assert pace(1 / rate, fps) == found and fps in RATES
    assert all(pace(1 / 25, one)[1] == one for one in RATES)
