"""Every number that may be given has a declared range, and what is beyond it is refused in one line."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import typing
from operator import attrgetter
from typing import Annotated, Literal

import pytest

from loco_mjx import config as config_lib
from loco_mjx import ranges
from loco_mjx.cli.main import VERBS, main
from loco_mjx.config import Config
from loco_mjx.deploy.mujoco_robot import Imperfections
from loco_mjx.deploy.safety import Limits
from loco_mjx.errors import UserError
from loco_mjx.ranges import Range
from loco_mjx.run.schedule import LoopOptions
from tests.refusals import refusal, says

ABSURD = (math.nan, math.inf, -math.inf, -1, 2**63)
OPTIONS = {verb: importlib.import_module(f"loco_mjx.cli.{verb}").Options for verb in VERBS}
KINDS = {"config": Config, "limits": Limits, "imperfections": Imperfections, "loop": LoopOptions} | OPTIONS


def numbers(hint, declared=None):
    """(int or float, its Range or None) for every number in a type."""
    if hint in (int, float):
        yield hint, declared
    elif typing.get_origin(hint) is not Literal:
        own = next((mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Range)), None)
        for part in typing.get_args(hint):
            yield from numbers(part, own)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())
def test_every_number_has_a_range_which_its_default_is_in_and_nothing_absurd(kind):
    for path, hint in ranges.leaves(kind):
        for _, declared in numbers(hint):
            assert declared is not None, path
            assert not any(value in declared for value in (math.nan, math.inf, -math.inf, 2**63, -(2**63))), path
    with_defaults = not any(f.default is f.default_factory for f in dataclasses.fields(kind))
    if with_defaults:
        ranges.check(kind())


def replaced(node, path, value):
    name, _, rest = path.partition(".")
    return dataclasses.replace(node, **{name: replaced(getattr(node, name), rest, value) if rest else value})


def spoilt(tree):
    """(path, tree with an absurd value there, that value, the range declared for it) for every value of a tree."""
    for path, hint in ranges.leaves(type(tree)):
        now, declared = attrgetter(path)(tree), [declared for _, declared in numbers(hint)]
        for value in ABSURD:
            wholes = [value]
            if isinstance(now, tuple):
                wholes = [(*now[:i], value, *now[i + 1 :]) for i in range(len(now))]
            for whole in wholes:
                yield path, replaced(tree, path, whole), value, declared[0] if declared else None


def test_absurd_values_of_every_key_are_refused_or_declared():
    count = 0
    for path, config, value, declared in spoilt(Config()):
        try:
            config_lib.check(config)
        except UserError as error:
            assert "\n" not in str(error)
            assert path.rpartition(".")[2] in str(error), path
            count += 1
        else:
            assert declared is not None and value in declared, (path, value)
            assert value == -1, path
    assert count > 5 * 80


def test_absurd_limits_and_imperfections_are_refused():
    for tree, name in ((Limits(), "limits"), (Imperfections(), "imperfections"), (LoopOptions(), "")):
        for path, changed, _, _ in spoilt(tree):
            with refusal(f"{name}.{path}" if name else path):
                ranges.check(changed, name)


def test_what_a_file_holds_is_checked_too():
    values = config_lib.to_dict(Config())
    for key, value, said in (
        ("clip", math.nan, "ppo.clip nan 0 10"),
        ("epochs", 2.5, "ppo.epochs 2.5 whole 1 1000"),
        ("num_envs", "many", "ppo.num_envs many whole"),
        ("optimizer", "both", "ppo.optimizer both joint separate"),
        ("learning_rate_decay", 1, "ppo.learning_rate_decay 1 True False"),
    ):
        text = json.dumps(values | {"ppo": values["ppo"] | {key: value}})
        with refusal(said):
            config_lib.from_dict(Config, json.loads(text))
    for wrong, kind in (
        ([], "Config"),
        ({"ppo": [1]}, "PPOConfig"),
        ({"env": {"observation": 3}}, "ObservationConfig"),
    ):
        with refusal(f"{kind} keys"):
            config_lib.from_dict(Config, wrong)


COMMANDS = {
    "checkpoint nan": (["train", "--checkpoint-minutes", "nan"], "checkpoint-minutes nan 0 100000"),
    "evaluations": (["train", "--evaluations", str(2**63)], "evaluations 9223372036854775808"),
    "rate": (["train", "--ppo.learning-rate", "inf"], "ppo.learning_rate inf 0 1"),
    "large rate": (["train", "--ppo.learning-rate", "1e6"], "ppo.learning_rate 1000000.0 0 1"),
    "norm": (["train", "--ppo.max-grad-norm", "nan"], "ppo.max_grad_norm nan"),
    "horizon": (["train", "--env.horizon", str(2**63)], "env.horizon 9223372036854775808 1 1000000"),
    "pair": (["train", "--env.randomization.kp", "nan", "90"], "env.randomization.kp (nan, 90.0) each"),
    "envs": (["train", "--num-envs", "-3"], "num-envs -3 1"),
    "processes": (["train", "--num-processes", "0"], "num-processes 0 1"),
    "samples": (
        ["train", "--total-steps", "2000000000", "--num-envs", "1048576", "--ppo.unroll", "65536"],
        "68719476736 2147483647",
    ),
    "swept": (["sweep", "--set", "ppo.clip=nan"], "ppo.clip nan"),
    "variant": (["sweep", "--policies", "loco-transformer+hold=0"], "network.hold 0 1"),
    "episodes": (["evaluate", "run", "--episodes", "-1"], "episodes -1 1 1000000"),
    "seed": (["evaluate", "run", "--seed", "-1"], "seed -1 0 2147483647"),
    "bench": (["bench", "depth", "--seconds", "inf"], "seconds inf 0 3600"),
    "bench's envs": (["bench", "env", "--num-envs", str(2**63)], "num-envs 9223372036854775808"),
    "deploy": (["deploy", "policy", "--seconds", "inf"], "seconds inf"),
    "dropped": (["deploy", "policy", "--imperfections.dropped", "nan"], "imperfections.dropped nan"),
    "limit": (["deploy", "policy", "--limits.missed", "0"], "limits.missed 0 1 100"),
    "film": (["play", "--zero", "--video", "a.gif", "--seconds", "nan"], "seconds nan"),
    "columns": (["play", "--zero", "--video", "a.gif", "--columns", "0"], "columns 0 1 20"),
    "solver": (["simcheck", "policy", "--solver", "20", "0"], "solver (20, 0) each 1 1000"),
    "scene": (["scene", "--seed", "4294967296", "--out", "a.xml"], "seed 4294967296"),
}


@pytest.mark.parametrize(("args", "said"), COMMANDS.values(), ids=COMMANDS.keys())
def test_a_value_beyond_its_range_is_one_line_and_nothing_is_written(args, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(args) == 2
    err = capsys.readouterr().err
    assert says(err, said) and len(err.splitlines()) == 1, err
    assert list(tmp_path.iterdir()) == []


Small = Annotated[int, Range(1, 3)]


@pytest.mark.parametrize(
    ("value", "hint", "accepted"),
    [
        (0.0, Annotated[float, Range(0, 1, above=True)], "more than 0, up to 1"),
        (1.0, Annotated[float, Range(0, 1, below=True)], "0, less than 1"),
        (1, Annotated[float, Range(0, 1)], None),
        (True, Small, "a whole number, 1 to 3"),
        (None, Small | None, None),
        (4, Small | None, "1 to 3 or None"),
        ((1, 2), tuple[Small, Small], None),
        ((1, 2, 3), tuple[Small, Small], "2 values"),
        ((1, 9), tuple[Small, ...], "each 1 to 3"),
        ([1], tuple[Small, ...], "several values"),
        (1, Literal[1, 2], None),
        (True, Literal[1, 2], "1, 2"),
        (1, bool, "True or False"),
        (3, str, "a word"),
    ],
)
def test_what_a_type_accepts(value, hint, accepted):
    assert ranges.complaint(value, hint) == accepted
