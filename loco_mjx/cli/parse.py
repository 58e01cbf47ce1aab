"""tyro, with its boxed errors brought down to one line: what is wrong, and what is accepted."""

from __future__ import annotations

import contextlib
import difflib
import io
import re
from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

from loco_mjx import ranges
from loco_mjx.cli import page, words
from loco_mjx.cli.options import REGISTRY
from loco_mjx.errors import UserError

T = TypeVar("T")


def parse(
    kind: type[T],
    args: Sequence[str],
    prog: str,
    default: T | None = None,
    names: Sequence[str] = (),
    keys: Sequence[str] = (),
) -> T:
    """Fills a dataclass from the command line; one option per field, nested fields joined by dots.

    Args:
        kind: the dataclass.
        args: the words of the command line.
        prog: the command, for its help.
        default: an instance whose values are the defaults.
        names: kinds of names that the help lists: "tasks", "policies", "presets".
        keys: fields, each a dataclass, whose options only `--help-all` lists; they need a default.

    Raises:
        UserError: on anything that is not accepted, a value beyond its declared range included, in one line.
        SystemExit: with code 0, after printing the help.
    """
    args = words.without_imports(args)  # loaded by now
    if page.asked(args):
        _help(kind, prog, default, names, keys, page.ALL in args)
    words.refuse_contradictions(kind, args)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            filled, unknown = _tyro(kind, args, prog, default)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise UserError(
            f"{_first_paragraph(complaint.getvalue())}; `{prog} {page.ALL if keys else '--help'}` lists the options"
        ) from None
    if unknown:
        raise UserError(_unknown(unknown, args, _options(kind, prog, default)))
    ranges.check(filled, called=_called)
    return filled


def _called(path: str) -> str:
    """A key of the configuration as it is written there, an option as on the command line."""
    path = path.removeprefix("loop.")  # whose options stand beside the command's own
    return path if "." in path else path.replace("_", "-")


def _help(
    kind: type[T], prog: str, default: T | None, names: Sequence[str], keys: Sequence[str], everything: bool
) -> NoReturn:
    """Prints the help, all of it or without the keys of a configuration."""
    said = page.description(kind, names, keys, everything)
    if keys and default is not None and not everything:
        kind, default = page.brief(kind, default, keys)
    _tyro(kind, ["--help"], prog, default, said)
    raise SystemExit(0)


def _tyro(
    kind: type[T], args: Sequence[str], prog: str, default: T | None, description: str | None = None
) -> tuple[T, list[str]]:
    import tyro

    text = [words.hyphens(word) for word in args]
    more: dict[str, Any] = {} if default is None else {"default": default}
    markers = (tyro.conf.FlagCreatePairsOff,)
    with REGISTRY:
        return tyro.cli(
            kind, args=text, prog=prog, description=description, return_unknown_args=True, config=markers, **more
        )


def _options(kind: type[T], prog: str, default: T | None) -> list[str]:
    """Every option's name, read from the help."""
    page = io.StringIO()
    with contextlib.redirect_stdout(page), contextlib.suppress(SystemExit):
        _tyro(kind, ["--help"], prog, default)
    return sorted({words.IMPORT} | {name for line in page.getvalue().splitlines() for name in _names_of(line)})


def _names_of(line: str) -> list[str]:
    """The options that a line of help introduces; none where it merely mentions one."""
    text = line.strip("│ ")
    return re.findall(r"--[a-z][\w.-]*", text) if text.startswith("-") else []


def _unknown(unknown: Sequence[str], args: Sequence[str], options: list[str]) -> str:
    """The complaint about words that no option took."""
    word = next((word for word in unknown if word.startswith("-")), None)
    if word is None:
        place = list(args).index(unknown[0]) if unknown[0] in args else 0
        after = f" after '{args[place - 1]}'" if place else ""
        return f"unexpected word '{unknown[0]}'{after}; accepted: {_group('', options)}"
    name = word.partition("=")[0]
    close = difflib.get_close_matches(name, options, n=1)
    # The last part alone, for who forgot where a key lives: --learning-rate for --ppo.learning-rate.
    close = close or [option for option in options if option.split(".")[-1] == name.lstrip("-")]
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    return f"unknown option '{name}'{hint}; accepted: {_group(close[0] if close else name, options)}"


def _group(name: str, options: list[str]) -> str:
    """The options beside one, and the groups (`--ppo.*`) where that one belongs to none."""
    group = name.rpartition(".")[0]
    beside = [option for option in options if option.rpartition(".")[0] == group]
    if beside and group:
        return ", ".join(beside)
    groups = sorted({option.split(".")[0] + ".*" for option in options if "." in option})
    return ", ".join([option for option in options if "." not in option] + groups)


def _first_paragraph(boxed: str) -> str:
    """The text of tyro's box, drawn with lines or in ASCII, up to its first rule, on one line."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", boxed)
    lines = [line.strip("│ ") for line in plain.splitlines() if line.strip() and line[0] not in "╭╰"]
    rules = [i for i, line in enumerate(lines) if set(line) <= {"─", "-"}]
    if "╭" not in plain and rules and rules[0] == 1:  # in ASCII the title stands above a rule
        lines, rules = lines[2:], [i - 2 for i in rules[1:]]
    return " ".join(lines[: rules[0] if rules else None]).rstrip(".")
