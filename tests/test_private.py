"""Tests use the package as its users do: what begins with `_` in `loco_mjx` is not theirs to touch."""

import ast
import re
from pathlib import Path

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "loco_mjx"
LOOKS = {"getattr", "setattr", "delattr", "hasattr", "attrgetter"}  # functions that take an attribute by its name


def private(name):
    return name.startswith("_") and not name.endswith("_")  # which Python and IPython have for what they call


def defined(tree):
    """The private names that a file defines: functions, classes, variables, attributes of `self`."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.id if isinstance(node, ast.Name) else node.attr)
    return {name for name in found if private(name)}


def used(tree):
    """(line, name) of what a file takes from elsewhere, in programs that it holds as text, too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("loco_mjx"):
            yield from ((node.lineno, one.name) for one in node.names)
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in LOOKS:
            words = [one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
            yield from ((node.lineno, word) for word in words)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from ((node.lineno, name) for name in re.findall(r"\.(_[A-Za-z]\w*)", node.value))


def taken(text, packages):
    """(line, name) of the package's private names in a test's text; a name that it defines itself is its own."""
    tree = ast.parse(text)
    own = defined(tree)
    return sorted((line, name) for line, name in used(tree) if private(name) and name in packages - own)


def test_no_test_takes_a_private_name_of_the_package():
    packages = set().union(*(defined(ast.parse(path.read_text())) for path in PACKAGE.rglob("*.py")))
    assert len(packages) > 100
    found = {str(path.relative_to(TESTS)): taken(path.read_text(), packages) for path in TESTS.rglob("*.py")}
    assert {name: names for name, names in found.items() if names} == {}


def test_each_way_of_taking_one_is_found():
    ways = [
        "from loco_mjx.x import _a",
        "thing._a",
        "monkeypatch.setattr(thing, '_a', None)",
        "monkeypatch.setattr('loco_mjx.x._a', None)",
        "CHILD = 'import loco_mjx; loco_mjx.x._a()'",
    ]
    assert all(taken(way, {"_a"}) == [(1, "_a")] for way in ways)
    for fine in ("self._b", "def _a(): pass\n_a()\nself._a", "'_a'", "from elsewhere import _a", "thing.__dict__"):
        assert taken(fine, {"_a"}) == []
