"""Which versions work, tried out: ``python -m experiments.versions``, or `make versions`.

On every Python from 3.11 to 3.13 that this machine has: the oldest JAX that pyproject.toml allows, the newest that
there is, and those of ALSO; and once every lower bound together. Each is set up in an environment of its own, trains a
policy for an instant, renders, exports, and runs what it exported. A row of the table is replaced by the newest of its
kind, so that a part can be tried again: ``python -m experiments.versions 3.12 0.11.2``.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from loco_mjx.compare.markup import markdown

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "versions.md"
PYTHONS = ("3.11", "3.12", "3.13")
OLDEST, NEWEST, LOWEST = "oldest JAX", "newest JAX", "all lower bounds"
ALSO = ("0.11.2",)  # versions of JAX, such as a GPU machine without a network may have
EXTRAS = ("train", "deploy")
EXPORT = "export"  # of which our own policies need all but
UNTRIED = "jax2onnx"  # which asks for newer versions of JAX and Flax than the rest does
SHOWN = ("jax", "flax", "mujoco", "numpy")
SMALL = "--ppo.num-envs 2 --ppo.unroll 4 --ppo.minibatch 8 --ppo.epochs 1 --ppo.pool-size 2 --total-steps 8"
STEPS = {
    "train": f"train --task thin --policy loco-transformer {SMALL} --evaluations 0 --out run",
    "depth": "bench depth --task thin --num-envs 2 --seconds 0.1 --json",
    "scene": "scene --task thin --out scene.xml",
    "export": "export run --out policy",
    "deploy": "deploy policy --robot mujoco --task thin --seconds 0.4",
}
HEAD = ["Python", "with", *SHOWN, "install", *STEPS]
SECONDS = 3600  # that one command may take, on a busy machine
TEXT = """# Versions

What `make versions` has tried, on {machine}: LocoTransformer trained for an instant on `thin`, depth frames, a scene,
the policy's export, and the exported policy in C MuJoCo. Where "install" says "none", that JAX has no package for that
Python.

"""


def exporting() -> list[str]:
    """What the export of our own policies needs beside the rest."""
    specs = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"][EXPORT]
    return [spec for spec in specs if not spec.startswith((UNTRIED, "loco-mjx"))]


def lower_bounds() -> dict[str, str]:
    """The oldest version that pyproject.toml allows of every package that is tried."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    specs = [*project["dependencies"], *(spec for extra in EXTRAS for spec in extras[extra]), *exporting()]
    found = (re.match(r"([\w-]+)>=([\d.]+)", spec) for spec in specs)
    return {match[1]: match[2] for match in found if match}


def interpreter(version: str) -> str | None:
    """A Python of this version: pyenv's, or one on the path."""
    found = sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python"))
    return str(found[-1]) if found else shutil.which(f"python{version}")


def pins(asked: str) -> list[str]:
    """What is installed beside the project."""
    bounds = lower_bounds()
    if asked == LOWEST:
        return [f"{name}=={version}" for name, version in bounds.items()] + [f"jaxlib=={bounds['jax']}"]
    if asked == NEWEST:
        return ["jax"]
    version = bounds["jax"] if asked == OLDEST else asked
    return [f"jax=={version}", f"jaxlib=={version}"]


def run(command: list[str], folder: Path) -> tuple[str, str]:
    """One command: "ok", or how it failed; and what it printed."""
    inherited = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    surroundings = inherited | {"XDG_CACHE_HOME": str(folder / "cache")}  # every version compiles for itself
    try:
        done = subprocess.run(command, cwd=folder, env=surroundings, capture_output=True, text=True, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return "too slow", ""
    said = done.stdout + done.stderr
    if done.returncode < 0:
        return signal.Signals(-done.returncode).name, said
    return ("ok" if done.returncode == 0 else f"exit code {done.returncode}"), said


def attempt(version: str, asked: str, folder: Path) -> dict[str, str]:
    """One row of the table."""
    row = dict.fromkeys(HEAD, "") | {"Python": version, "with": asked}
    python = interpreter(version)
    if python is None:
        return row | {"install": "no such Python here"}
    venv = folder / "venv"
    subprocess.run([python, "-m", "venv", str(venv)], check=True)
    own = str(venv / "bin" / "python")
    pip = [own, "-m", "pip", "--disable-pip-version-check"]
    what = [f"{ROOT}[{','.join(EXTRAS)}]", *exporting(), *pins(asked)]
    row["install"], said = run([*pip, "install", "--quiet", "--no-compile", "--prefer-binary", *what], folder)
    if row["install"] != "ok":
        print(said[-2000:], file=sys.stderr)
        return row | {"install": "none" if "No matching distribution found for jax" in said else row["install"]}
    ask = f"from importlib.metadata import version as v\nfor name in {SHOWN!r}: print(name, v(name))"
    row |= dict(line.split() for line in run([own, "-c", ask], folder)[1].splitlines())
    for step, words in STEPS.items():
        row[step], said = run([own, "-m", "loco_mjx.cli.main", *words.split()], folder)
        if row[step] != "ok":
            print(said[-2000:], file=sys.stderr)
    return row


def combinations() -> list[tuple[str, str]]:
    """All (Python, what with)."""
    return [(PYTHONS[0], LOWEST), *((version, asked) for version in PYTHONS for asked in (OLDEST, NEWEST, *ALSO))]


def read() -> dict[tuple[str, str], dict[str, str]]:
    """The table's rows, as far as they have today's columns."""
    lines = TABLE.read_text().splitlines() if TABLE.exists() else []
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    if not table or table[0] != HEAD:
        return {}
    return {(cells[0], cells[1]): dict(zip(HEAD, cells, strict=True)) for cells in table[2:]}


def write(rows: dict[tuple[str, str], dict[str, str]]) -> None:
    """The table, in the combinations' order."""
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    known = [[rows[which][name] for name in HEAD] for which in combinations() if which in rows]
    TABLE.write_text(TEXT.format(machine=machine) + markdown(HEAD, known))


def main() -> int:
    """Tries the combinations and writes the table after each; 1 if one of them installs but does not work."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="only combinations with these, e.g. 3.12, or 'newest JAX'")
    words = set(parser.parse_args().words)
    failed = False
    for which in combinations():
        if not words <= set(which):
            continue
        with tempfile.TemporaryDirectory(prefix="versions-") as folder:
            row = attempt(*which, Path(folder))
        write(read() | {which: row})
        print(*row.values(), sep=" · ", flush=True)
        failed |= any(row[step] not in ("ok", "") for step in STEPS)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
