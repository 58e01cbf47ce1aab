"""What help shows first, and that it leaves out nothing for good."""

import dataclasses
import re
import subprocess
import sys

import pytest

from loco_mjx.cli.main import main
from loco_mjx.config import PRESETS, Config, flatten, to_dict
from loco_mjx.networks.registry import POLICIES
from loco_mjx.scene.tasks import TASKS


def page(capsys, *words):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code in (0, None)
    return capsys.readouterr().out


def options(text):
    """Those that a page introduces, whether it is drawn with lines or in ASCII."""
    return set(re.findall(r"^[│|]? *(--[a-z][\w.-]*)", text, re.MULTILINE))


def names(text):
    """The words above the options."""
    return set(text.partition("--help ")[0].replace(",", " ").split())


def test_the_first_screen_of_train_names_what_is_accepted_and_its_own_options(capsys):
    text = page(capsys, "train", "--help")
    assert {*TASKS, *POLICIES, *PRESETS} <= names(text)
    assert len(text.splitlines()) < 72  # what a terminal shows, beside the tail of the options
    assert {"--task", "--policy", "--preset", "--total-steps", "--out", "--evaluations"} <= options(text)
    assert "--help-all" in text and not [option for option in options(text) if "." in option]


def test_every_key_is_in_the_long_help_with_the_presets_default(capsys):
    text = page(capsys, "train", "--preset", "paper", "--help-all")
    keys = {f"--{key.replace('_', '-')}" for key in flatten(to_dict(Config())) if "." in key}
    assert keys | options(page(capsys, "train", "--help")) == options(text)
    assert re.search(r"--ppo\.epochs INT[│|\s]*\(default: 3\)", text)
    assert re.search(r"--ppo\.epochs INT[│|\s]*\(default: 2\)", page(capsys, "train", "--help-all"))


@pytest.mark.parametrize("verb", ["sweep", "evaluate", "play", "scene", "bench"])
def test_verbs_that_take_a_task_name_them_all(verb, capsys):
    assert set(TASKS) <= names(page(capsys, verb, "--help"))


def test_help_needs_no_extra():
    """On an installation without JAX the names are left out."""
    absent = "import sys; sys.modules['jax'] = None; from loco_mjx.cli.main import main; main(['evaluate', '--help'])"
    done = subprocess.run([sys.executable, "-c", absent], capture_output=True, text=True)
    assert done.returncode == 0 and "--episodes" in done.stdout and "tasks:" not in done.stdout


def test_a_shortened_page_still_has_the_given_defaults():
    from loco_mjx.cli import page as help_page
    from loco_mjx.cli.train import KEYS, Options

    kind, default = help_page.brief(Options, dataclasses.replace(Options(), seed=3), KEYS)
    assert isinstance(default, kind) and isinstance(default, Options) and default.seed == 3
