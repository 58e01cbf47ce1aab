"""Paths that cannot be, and terminals that lack characters: one line, or another spelling, never a traceback."""

from __future__ import annotations

import io
import sys

import pytest

from loco_mjx.cli.main import main

LONG, DEEP, LOOP = "a" * 300, "/".join(["b" * 200] * 25), "loop/run"
VERBS = {
    "train": ["train", "--policy", "state-only", "--out", "PATH"],
    "evaluate": ["evaluate", "PATH"],
    "table": ["table", "PATH"],
    "curves": ["curves", "PATH"],
    "export": ["export", "PATH"],
    "export to": ["export", "nothing", "--out", "PATH"],
    "simcheck": ["simcheck", "PATH"],
    "deploy": ["deploy", "PATH"],
    "log": ["deploy", "policy", "--log", "PATH"],
    "play": ["play", "PATH", "--video", "a.gif"],
    "film": ["play", "--zero", "--video", "PATH.gif"],
    "scene": ["scene", "--out", "PATH"],
    "sweep": ["sweep", "--out", "PATH"],
}


@pytest.mark.parametrize("path", [LONG, DEEP, LOOP, "x\udcff\udcfey"], ids=["long", "deep", "loop", "no text"])
@pytest.mark.parametrize("words", VERBS.values(), ids=VERBS.keys())
def test_a_path_that_cannot_be_is_one_line(words, path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    assert main([word.replace("PATH", path) for word in words]) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1, err
    assert [entry.name for entry in tmp_path.iterdir()] == ["loop"]


def test_a_terminal_without_a_character_gets_another_spelling(monkeypatch):
    page = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", page)
    with pytest.raises(SystemExit) as stop:
        main(["train", "--help-all"])
    page.flush()
    assert stop.value.code in (0, None)
    text = page.buffer.getvalue().decode("ascii")
    assert "--env.reward.energy" in text and "\\u2016" in text  # ‖τ‖² of its description
