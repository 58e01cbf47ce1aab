"""Rooms face one way: no module imports from a room above its own, and an arrow that does is found."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from importlinter import cli

ROOT = Path(__file__).parents[1]


def lint(folder):
    """Holds the package in a folder against the layers that its pyproject.toml declares."""
    command = [sys.executable, "-c", f"import {cli.__name__}; {cli.__name__}.lint_imports_command()", "--no-cache"]
    where = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}", "COLUMNS": "400"}
    done = subprocess.run(command, cwd=folder, env=where, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def test_no_room_imports_from_one_above():
    code, said = lint(ROOT)
    assert code == 0, said


ARROWS = {
    "at the top of a file": ("env/reward.py", "from loco_mjx.ppo import gae\n", "loco_mjx.env"),
    "inside a function": ("scene/pool.py", "def late():\n    import loco_mjx.cli.main\n", "loco_mjx.scene"),
    "between neighbours": (
        "physics/model.py",
        "def late():\n    from loco_mjx.depth import render\n",
        "loco_mjx.physics",
    ),
    "a room without a place": ("attic/__init__.py", "import loco_mjx.cli.main\n", "attic"),
}


@pytest.mark.parametrize(("name", "text", "said"), ARROWS.values(), ids=ARROWS.keys())
def test_an_arrow_up_is_found(tmp_path, name, text, said):
    shutil.copytree(
        ROOT / "loco_mjx",
        tmp_path / "loco_mjx",
        ignore=lambda folder, names: {
            one for one in names if not one.endswith(".py") and not (Path(folder) / one).is_dir()
        },
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = tmp_path / "loco_mjx" / name
    path.parent.mkdir(exist_ok=True)
    with path.open("a") as file:
        file.write(text)
    code, output = lint(tmp_path)
    assert code == 1 and said in output, output
