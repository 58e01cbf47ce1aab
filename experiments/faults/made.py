"""Makes command lines that have to be refused: a right one of any command, with one thing in it that cannot be."""

from __future__ import annotations

import random
import string
from collections.abc import Callable
from pathlib import Path

from experiments.faults import values, wrong
from loco_mjx import policies
from loco_mjx.cli.main import VERBS
from loco_mjx.networks.registry import POLICIES
from loco_mjx.scene.tasks import TASKS

Words = list[str]
SHIPPED = policies.names()[0]
# How often each command comes; reading one of `train` takes longest.
OFTEN = {"train": 5, "deploy": 5, "evaluate": 3, "play": 3, "simcheck": 3, "sweep": 2, "bench": 2, "export": 2}
NAMED = {  # options that take a name
    "train": ("--task", "--policy", "--preset", "--eval-tasks", "--method"),
    "evaluate": ("--task",),
    "sweep": ("--tasks", "--policies", "--preset", "--eval-tasks", "--seeds", "--set", "--launcher"),
    "bench": ("--task", "--policy"),
    "simcheck": ("--task",),
    "deploy": ("--task", "--robot"),
    "play": ("--task",),
    "scene": ("--task",),
}
UNKNOWN = (
    *(["--banana", "3"], ["--größe", "3"], ["-x"], ["--", "extra"], ["extra", "twice"], ["--=3"], ["---task", "thin"]),
    *(["--\udcff"], ["--task\u200b=thin"], ["--no-seed"], ["\udcff"], ["🤖"], ["x" * 10_000], ["%s"], ["-", "twice"]),
)
LISTS = ("", ",", "thin,,wide", "0-", "-3", "5-1", "a", "0-999999", "1;2", "state-only+", "state-only+layers", "+", "=")
NO_CHANGES = ("ppo.clip", "ppo.clip=nan", "ppo.clip=", "banana=3", "env.task=wide", "seed", "ppo=3", "ppo.epochs=0")
CONTRADICTIONS = {
    "train": (
        "--preset paper --preset fast",
        "--num-envs 8 --ppo.num-envs 16",
        "--task thin --env.task wide",
        "--seed 1 --seeds 0-2",
        "--seeds 0-2 --method distill",
        "--seeds 0,0",
        "--coordinator node1:4321",
        "--process-id 1",
        "--coordinator nowhere --process-id 0 --num-processes 2",
        "--coordinator a:0 --process-id 0 --num-processes 2",
        "--coordinator a:1 --process-id 2 --num-processes 2",
        "--ppo.minibatch 1048577",
        "--env.observation.depth.near 5 --env.observation.depth.far 1",
        "--env.randomization.kp 90 40",
    ),
    "play": ("--random", "--web", "--fps 7", "--video nowhere/x.mp4", "--video x.avi", "--figure x.exe"),
    "evaluate": ("--seed 1 --seed 2", "--episodes 1 --episodes 2"),
    "sweep": ("--ray-address localhost:1", "--cpus-per-cell 2", "--num-envs 7", "--set ppo.minibatch=1048577"),
    "bench": ("--seeds 2", "--num-envs 8 --num-envs 16"),
    "deploy": ("--log /nowhere/x.npz", "--log /", "--robot a1", "--seconds 1 --seconds 2"),
    "scene": ("--out /nowhere/x.xml", "--out /", "--seed 1 --seed 2"),
}


def right(verb: str, place: Path) -> Words:
    """A command line that would run, if it were not for the fault to come."""
    out = str(place / "out")
    more = {
        "train": ["--out", out, "--total-steps", "32"],
        "evaluate": [SHIPPED],
        "sweep": ["--out", out, "--dry-run"],
        "table": [str(place)],
        "curves": [str(place)],
        "bench": ["env"],
        "export": [SHIPPED, "--out", out],
        "simcheck": [SHIPPED],
        "deploy": [SHIPPED],
        "play": ["--zero", "--video", f"{out}.mp4"],
        "scene": ["--out", f"{out}.xml"],
    }
    return [verb, *more[verb]]


def line(place: Path, numbers: random.Random) -> Words:
    """A command line with one thing in it that cannot be.

    Args:
        place: an empty folder, for what the line needs.
        numbers: to draw from.
    """
    verb = numbers.choice([name for name in VERBS for _ in range(OFTEN.get(name, 1))])
    kinds = [kind for kind in KINDS if kind is not _value or values.options(verb)]
    return numbers.choice(kinds)(verb, place, numbers)


def _value(verb: str, place: Path, numbers: random.Random) -> Words:
    """A value that its option does not take; sometimes joined to it by =."""
    option = numbers.choice(values.options(verb))
    given = values.refused(option, numbers)
    joined = len(given) == 1 and numbers.random() < 0.5
    return [*right(verb, place), *([f"{option.name}={given[0]}"] if joined else [option.name, *given])]


def _misspelt(verb: str, place: Path, numbers: random.Random) -> Words:
    """An option with a letter too many, too few, or another one."""
    known = values.names(verb)
    name = numbers.choice(known)
    at, letter = numbers.randrange(3, len(name)), numbers.choice(string.ascii_letters + "é_.-")
    wrong_name = numbers.choice((name[:at] + letter + name[at:], name[: at - 1] + letter + name[at:], name + letter))
    if wrong_name.replace("_", "-") in known:
        wrong_name += "x"
    return [*right(verb, place), wrong_name, *numbers.choice((["3"], []))]


def _unknown(verb: str, place: Path, numbers: random.Random) -> Words:
    """Words that belong to nothing."""
    return [*right(verb, place), *numbers.choice(UNKNOWN)]


def _name(verb: str, place: Path, numbers: random.Random) -> Words:
    """A name that nothing has; a list that is none."""
    if verb not in NAMED:
        return _misspelt(verb, place, numbers)
    option, name = numbers.choice(NAMED[verb]), numbers.choice([*TASKS, *POLICIES, "paper", "fast"])
    if option == "--set":
        return [*right(verb, place), option, numbers.choice(NO_CHANGES)]
    nobody = (name[1:], name + "s", name.upper(), f" {name}x", name[::-1], *wrong.NAMES)
    chosen = numbers.choice((*nobody, *LISTS) if option.endswith("s") else (*nobody, f"{name} ", f"{name}\n", ""))
    return [*right(verb, place), f"{option}={chosen}"]


def _given(verb: str, place: Path, numbers: random.Random) -> Words:
    """Something else where a run, a policy, a scene or a folder should be."""
    if verb in ("evaluate", "export", "simcheck", "deploy", "play", "table", "curves"):
        if verb == "deploy" and numbers.random() < 0.3:
            return ["deploy", SHIPPED, "--scene", str(wrong.scene(place, numbers))]
        path = str(wrong.folder(place, numbers))
        words = [path if word in (SHIPPED, str(place), "--zero") else word for word in right(verb, place)]
        return words
    if verb == "scene" and numbers.random() < 0.5:
        return ["scene", "--out", str(place)]
    taken = place / "taken"
    if verb == "train" and numbers.random() < 0.5:
        taken.mkdir()
        (taken / numbers.choice(("config.json", "foreign"))).write_text(numbers.choice(wrong.NO_JSON))
    else:
        taken.write_text("a file")
    if verb == "bench":
        return ["bench", str(taken)]
    below = "/x" if verb == "scene" else ""
    return [f"{taken}{below}" if word.startswith(str(place)) else word for word in right(verb, place)]


def _contradiction(verb: str, place: Path, numbers: random.Random) -> Words:
    """Options that do not go together."""
    if verb not in CONTRADICTIONS:
        return _unknown(verb, place, numbers)
    return [*right(verb, place), *numbers.choice(CONTRADICTIONS[verb]).split()]


def _verb(verb: str, place: Path, numbers: random.Random) -> Words:
    """A command that there is none of."""
    name = numbers.choice((verb.upper(), verb + "s", verb[1:], "", f"{verb} ", "--task", "-", "\udcff", "🤖"))
    return [name if name not in VERBS else "banana", *right(verb, place)[1:]]


KINDS: tuple[Callable[[str, Path, random.Random], Words], ...] = (
    *(4 * (_value,)),
    *(2 * (_misspelt,)),
    *(2 * (_name,)),
    *(3 * (_given,)),
    _unknown,
    _contradiction,
    _verb,
)
