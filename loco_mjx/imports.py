"""`--import`: loads the user's modules, which register tasks, policies, terms of the reward and robots."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from loco_mjx.errors import UserError
from loco_mjx.registry import IMPORTED_AS

SUFFIX = ".py"


def load(words: Iterable[str]) -> None:
    """Loads modules, each once.

    Args:
        words: names, as `import` takes them (the working directory is searched last), or paths of .py files.

    Raises:
        UserError: if there is no such module or file, or another module has its name; whatever the module itself
            raises is its own.
    """
    for word in words:
        if word.endswith(SUFFIX):
            _load_file(word)
        else:
            _load_name(word)


def absolute(word: str) -> str:
    """The same module as a word that means it in any working directory, where there is one.

    A package that is found in the working directory alone keeps its name: other machines need it on their path.
    """
    if word.endswith(SUFFIX):
        return str(Path(word).absolute())
    spec = importlib.util.find_spec(word) if "." not in word else None
    here = spec is not None and spec.origin is not None and Path(spec.origin) == Path.cwd() / (word + SUFFIX)
    return str(Path.cwd() / (word + SUFFIX)) if here else word


def _load_name(word: str) -> None:
    if not all(part.isidentifier() for part in word.split(".")):
        raise UserError(f"--import '{word}' is no name of a module; accepted: a module, or a path that ends in .py")
    _search(os.getcwd())
    try:
        importlib.import_module(word)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{word}.".startswith(f"{error.name}."):
            raise  # the module is there, and imports one that is not
        raise UserError(
            f"--import {word}: no module '{error.name}'; accepted: a module that Python finds, or a .py file"
        ) from None


def _load_file(word: str) -> None:
    path = Path(word)
    if not path.is_file():
        raise UserError(f"--import {word}: there is no such file; accepted: a module that Python finds, or a .py file")
    name = path.stem
    there = sys.modules.get(name)
    if there is not None:
        if _is(there, path):
            return
        raise UserError(f"--import {word}: there is another module '{name}' already; give the file another name")
    _search(str(path.absolute().parent))
    spec = importlib.util.spec_from_file_location(name, path.absolute())
    assert spec is not None and spec.loader is not None  # of a file that ends in .py
    module = importlib.util.module_from_spec(spec)
    setattr(module, IMPORTED_AS, word)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def _is(module: ModuleType, path: Path) -> bool:
    return getattr(module, "__file__", None) is not None and Path(str(module.__file__)).resolve() == path.resolve()


def _search(folder: str) -> None:
    """Has Python search a folder after all others, so that what lies there hides nothing."""
    if folder not in sys.path:
        sys.path.append(folder)
