"""pyproject.toml declares what the code imports, room by room, and nothing else."""

from __future__ import annotations

import ast
import functools
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OWN = {"loco_mjx", "tests", "experiments"}
ELSEWHERE = {"robot_interface": "Unitree's SDK is on no index"}  # imported, not declared
# Extras whose packages a room may import beside the base's; a room that is not listed may use `train` alone.
ROOMS = {
    "bench": {"train", "mpc", "dev"},  # what it measures beside ours comes with the developers' tools
    "cli": {"train", "deploy", "export"},
    "compare": {"train", "cluster"},
    "deploy": {"train", "deploy", "export", "a1"},
    "show": {"train", "play"},
    "whole_body": {"train", "mpc"},
}
NOT_IMPORTED = {
    "pytest-xdist": "make test runs on all cores",
    "ruff": "make lint",
    "mypy": "make lint",
    "rtree": "trimesh casts rays with it, in a test of the meshes",
}


def imports(folder: Path) -> dict[Path, set[str]]:
    """The third-party packages that every file of a folder imports, anywhere in it."""
    found = {}
    for path in folder.rglob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
        names |= {  # pytest.importorskip("ray"), importlib.import_module("robot_interface")
            node.args[0].value
            for node in nodes
            if isinstance(node, ast.Call)
            and getattr(node.func, "attr", "") in ("importorskip", "import_module")
            and isinstance(node.args[0], ast.Constant)
        }
        found[path] = {name.partition(".")[0] for name in names} - sys.stdlib_module_names - OWN - {""}
    return found


def distribution(spec: str) -> str:
    """A requirement's package, e.g. "jax[cuda12]>=0.7" -> "jax"."""
    return re.split(r"[\[<>=!;~ ]", spec, maxsplit=1)[0].lower().replace("_", "-")


def packages(specs: list[str]) -> set[str]:
    """The distributions that requirements name, without our own extras."""
    return {distribution(spec) for spec in specs} - {PROJECT["name"]}


installed = functools.cache(packages_distributions)  # reads the records of every package


def providers(module: str) -> set[str]:
    """The distributions that a module may come from."""
    return {name.lower().replace("_", "-") for name in installed().get(module, [module])}


def test_every_import_is_declared_where_its_room_s_users_install_it():
    extras = PROJECT["optional-dependencies"]
    for path, modules in imports(ROOT / "loco_mjx").items():
        room = path.relative_to(ROOT / "loco_mjx").parts[0]
        declared = packages(PROJECT["dependencies"]).union(*(packages(extras[e]) for e in ROOMS.get(room, {"train"})))
        for module in modules - ELSEWHERE.keys():
            assert providers(module) & declared, f"{path.relative_to(ROOT)} imports {module}, which no extra brings"


def test_what_tests_and_experiments_import_is_declared_too():
    declared = packages(PROJECT["dependencies"]).union(*map(packages, PROJECT["optional-dependencies"].values()))
    for folder in OWN:
        for path, modules in imports(ROOT / folder).items():
            missing = {module for module in modules - ELSEWHERE.keys() if not providers(module) & declared}
            assert not missing, f"{path.relative_to(ROOT)} imports {missing}, which no extra brings"


def test_every_declared_dependency_is_imported_or_has_a_reason():
    modules = set().union(*(set().union(*imports(ROOT / folder).values()) for folder in OWN))
    imported = set().union(*map(providers, modules))
    declared = packages(PROJECT["dependencies"]).union(*map(packages, PROJECT["optional-dependencies"].values()))
    assert declared - imported == NOT_IMPORTED.keys()


def test_every_declared_dependency_is_pinned():
    pinned = {distribution(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line}
    assert packages([*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"]]) <= pinned
