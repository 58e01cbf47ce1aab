from __future__ import annotations

import pytest

from loco_mjx.cli.main import main


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--zero"], "nothing to show; accepted: --video FILE.mp4 or .gif"),
        (["--video", "a.mp4"], "no policy to show"),
        (["--zero", "--random", "--video", "a.mp4"], "two agents"),
        (["--zero", "--video", "a.avi"], "accepted: .mp4, .gif"),
        (["--zero", "--figure", "a.mp4"], "accepted: .png, .svg"),
        (["--zero", "--video", "missing/a.mp4"], "there is no directory 'missing'"),
        (["--zero", "--video", "old.gif"], "'old.gif' exists; choose another name, or --overwrite it"),
        (["--zero", "--video", "a.gif", "--fps", "24"], "fps is 24.0; accepted: 25.0, 12.5, 5.0"),
        (["--zero", "--video", "a.gif", "--seconds", "0"], "seconds is 0.0"),
        (["--zero", "--video", "a.gif", "--task", "thick"], "unknown task 'thick' (did you mean 'thin'?)"),
        (["--zero", "--web", "--video", "a.gif"], "--web does not film"),
        (["--zero", "--attention", "--video", "a.gif"], "'zero' has no attention from a state token"),
        (["nowhere", "--video", "a.gif"], "no run in nowhere"),
        (["--zero", "--web", "--port", "0"], "port is 0"),
        (["--controller", "mpc", "--zero", "--video", "a.gif"], "--controller mpc walks without a policy"),
        (["--controller", "mpc", "--web"], "--web shows no --controller"),
        (["--controller", "mpc", "--vx", "nan", "--video", "a.gif"], "vx is nan; accepted: -10 to 10"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing_behind(args, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.gif").write_text("old")
    assert main(["play", *args]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["old.gif"]
    assert (tmp_path / "old.gif").read_text() == "old"
