from dataclasses import dataclass, field
from typing import Literal

import pytest
import tyro

from loco_mjx.cli.main import main
from loco_mjx.cli.parse import parse
from loco_mjx.errors import UserError
from tests.refusals import refusal, says


@dataclass(frozen=True)
class Inner:
    rate: float = 0.1
    sizes: tuple[float, float] = (1.0, 2.0)
    learning_rate: float = 1.0


@dataclass(frozen=True)
class Options:
    """Does things."""

    task: str = "thin"
    count: int = 1
    side: Literal[1, 2] = 1
    json: bool = False
    inner: Inner = field(default_factory=Inner)


def read(*args, default=None):
    return parse(Options, args, "loco-mjx do", default)


@pytest.fixture
def complaint(capsys):
    """What is said of words that are not accepted: by an error of ours, or by tyro on stderr."""

    def said(*args):
        with pytest.raises((UserError, SystemExit)) as error:
            read(*args)
        if isinstance(error.value, UserError):
            return str(error.value)
        assert error.value.code == 2
        return capsys.readouterr().err

    return said


def test_values_types_and_nesting():
    found = read("--task", "wide", "--count=3", "--json", "--inner.sizes", "3", "4", "--inner.learning_rate", "1e-4")
    assert found == Options("wide", 3, 1, True, Inner(0.1, (3.0, 4.0), 1e-4))


def test_defaults_come_from_the_instance_given():
    assert read("--count", "5", default=Options(task="mountain")) == Options(task="mountain", count=5)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--count", "many"), "--count many"),
        (("--count",), "--count"),
        (("--inner.sizes", "1"), "--inner.sizes"),
        (("--side", "3"), "--side 1 2"),
        (("stray",), "stray"),
        (("--count", "1", "2"), "2"),
        (("--tsk", "thin"), "--tsk --task"),
        (("--inner.learnin-rate", "3"), "--inner.learning-rate"),
        (("--learning-rate", "3"), "--inner.learning-rate"),  # a key without its group
    ],
)
def test_what_is_wrong_is_named(args, words, complaint):
    said = complaint(*args)
    assert says(said, words), said


def test_help_is_printed_and_is_no_error(capsys):
    with pytest.raises(SystemExit) as stop:
        read("--help")
    assert stop.value.code in (0, None)
    assert "--inner.learning-rate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--task", "thin", "--task", "wide"), "--task twice thin wide"),
        (("--task=thin", "--task", "wide"), "--task twice"),
        (("--inner.sizes", "1", "2", "--json", "--inner.sizes", "1", "3"), "--inner.sizes twice '1 2' '1 3'"),
        (("--inner.learning_rate=1", "--inner.learning-rate=2"), "--inner.learning-rate twice 1 2"),
        (("--count", "-1", "--count", "-2"), "--count twice -1 -2"),
    ],
)
def test_an_option_given_twice_with_different_values_is_refused(args, words, complaint):
    said = complaint(*args)
    assert says(said, words), said


def test_an_option_may_be_repeated():
    assert read("--task", "wide", "--json", "--task=wide", "--json") == Options("wide", json=True)


@dataclass(frozen=True)
class Placed:
    """Does things somewhere."""

    directory: tyro.conf.Positional[str]
    count: int = 1


def test_a_free_word_is_no_value_of_the_option_before_it():
    assert parse(Placed, ["--count", "2", "run", "--count", "2"], "loco-mjx do") == Placed("run", 2)
    with refusal("--count twice 2 3"):
        parse(Placed, ["--count", "2", "run", "--count", "3"], "loco-mjx do")


@pytest.mark.parametrize("words", ["train --task=", "sweep --dry-run --eval-tasks=", "play --zero --task="])
def test_an_empty_name_is_not_taken_for_the_default(words, capsys, tmp_path, monkeypatch):
    """As a script has it whose variable is not set."""
    monkeypatch.chdir(tmp_path)
    assert main([*words.split(), *(["--video", "a.gif"] if words.startswith("play") else [])]) == 2
    said = capsys.readouterr().err
    assert "''" in said and len(said.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
