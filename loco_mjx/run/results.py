"""Finds runs and their evaluations in a directory and those below it; refuses those that cannot be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loco_mjx import controllers
from loco_mjx.config import Config, flatten, to_dict
from loco_mjx.errors import UserError
from loco_mjx.run.directory import ABSENT, CONFIG, INFO, TEACHER, load_config, read_json
from loco_mjx.run.variant import CONTROLLER, METHOD_KEYS, Variant, default_keys

# Packages that what a robot does depends on.
COMPARED = ("loco-mjx", "mujoco", "mujoco-mjx", "jax")
# Keys in which runs of one method may differ.
FREE_KEYS = ("seed", "ppo.total_steps", "imports")


@dataclass(frozen=True, eq=False)
class Run:
    """A run in the directory.

    Attributes:
        path: its directory.
        config: its configuration.
        flat: the same, on one level.
    """

    path: Path
    config: Config
    flat: dict[str, Any]

    @classmethod
    def of(cls, path: Path, config: Config) -> Run:
        """The run of a configuration in a directory."""
        return cls(path, config, flatten(to_dict(config)))

    @property
    def samples(self) -> int:
        """It was to be trained on."""
        return self.config.ppo.iterations * self.config.ppo.samples_per_iteration


@dataclass(frozen=True, eq=False)
class Evaluation:
    """An evaluation of a run.

    Attributes:
        run: the run.
        path: of its file.
        task: evaluated on.
        samples: the policy was trained on.
        episodes: how many.
        metrics: the mean of each over the episodes.
        versions: of packages.
    """

    run: Run
    path: Path
    task: str
    samples: int
    episodes: int
    metrics: dict[str, float]
    versions: dict[str, str]


@dataclass(frozen=True)
class OverSeeds:
    """A metric over seeds: of each run its mean over episodes, then mean and standard deviation of these.

    Attributes:
        mean: over seeds.
        std: over seeds, the population's as in the paper.
        values: each seed's own mean.
    """

    mean: float
    std: float
    values: tuple[float, ...]


def over_seeds(values: Sequence[float]) -> OverSeeds:
    """Mean and standard deviation of the seeds' means."""
    return OverSeeds(float(np.mean(values)), float(np.std(values)), tuple(values))


def is_teacher(place: Path) -> bool:
    """Whether a run is part of the one whose folder it is in, which learns from it, or will."""
    if place.name != TEACHER:
        return False
    return (place.parent / CONFIG).exists() or load_config(place).policy == "privileged"


def find_runs(folder: Path) -> list[Run]:
    """Every run in a directory, by path.

    Raises:
        UserError: if there is none, or one that cannot be read.
    """
    if not folder.is_dir():
        raise UserError(f"{folder} is no directory; give one that `loco-mjx sweep` or `loco-mjx train` wrote")
    runs = []
    for path in sorted(folder.rglob(CONFIG)):
        if path.parent != folder and is_teacher(path.parent):
            continue
        runs.append(Run.of(path.parent, load_config(path.parent)))
    if not runs:
        raise UserError(f"no runs in {folder}; give a directory that `loco-mjx sweep` or `loco-mjx train` wrote")
    return runs


def find_evaluations(runs: Sequence[Run]) -> list[Evaluation]:
    """The evaluations of runs by their deterministic policy without randomisation: of each run and task the newest.

    The newest stands on most samples; of several such the one with most episodes counts.

    Raises:
        UserError: if a file is damaged or of another version.
    """
    best: dict[tuple[Path, str], Evaluation] = {}
    for run in runs:
        for path in sorted((run.path / "evaluation").glob("*.json")):
            found = _read(run, path)
            if found is None:
                continue
            key = (run.path, found.task)
            if key not in best or (found.samples, found.episodes) > (best[key].samples, best[key].episodes):
                best[key] = found
    return list(best.values())


def _read(run: Run, path: Path) -> Evaluation | None:
    content = read_json(path)
    try:
        if not content["deterministic"] or content["randomized"]:
            return None
        metrics = {name: float(value["mean"]) for name, value in content["metrics"].items()}
        task, samples, episodes = content["task"], int(content["samples"]), int(content["num_episodes"])
        return Evaluation(run, path, task, samples, episodes, metrics, dict(content["versions"]))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{path} is no evaluation of this version ({error!r}); evaluate the run again") from error


def trained_with(runs: Sequence[Run]) -> list[tuple[Path, dict[str, str]]]:
    """With which versions of packages runs were trained: a file and its versions, for every start of every run.

    Raises:
        UserError: if a file is damaged or of another version.
    """
    found = []
    for path in [run.path / INFO for run in runs if (run.path / INFO).is_file()]:
        info = read_json(path)
        try:
            found += [(path, dict(start["versions"])) for start in (info, *info.get("resumed", []))]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError(f"{path} does not say what it ran with ({error!r}); restore it, or remove it") from error
    return found


def check_versions(found: Sequence[tuple[Path, dict[str, str]]], remedy: str) -> None:
    """Refuses results of mixed versions.

    Args:
        found: files, and the versions of packages that they name.
        remedy: what to do about it.

    Raises:
        UserError: naming the package, its versions and a file of each.
    """
    for package in COMPARED:
        files = {versions.get(package, "unknown"): path for path, versions in found}
        if len(files) > 1:
            (one, here), (other, there) = sorted(files.items())[:2]
            raise UserError(
                f"results of mixed versions: {package} {one} in {here}, {other} in {there}; {remedy}, or accept it "
                "with --mixed-versions"
            )


def check_same_method(runs: Sequence[Run], label: str) -> None:
    """Refuses to take a mean over runs that were trained in different ways.

    Raises:
        UserError: naming the first key that differs and two runs.
    """
    seeds: dict[int, Run] = {}
    first = runs[0]
    for run in runs:
        twin = seeds.setdefault(run.config.seed, run)
        keys = (key for key in {**first.flat, **run.flat} if key not in FREE_KEYS)
        values = ((key, first.flat.get(key, ABSENT), run.flat.get(key, ABSENT)) for key in keys)
        differs = next(((key, one, other) for key, one, other in values if one != other), None)
        if differs is not None:
            key, one, other = differs
            raise UserError(
                f"{label} was trained in two ways: {key} is {one} in {first.path}, {other} in {run.path}; give a "
                "directory that holds one of them"
            )
        if twin is not run:
            raise UserError(
                f"{label} was trained twice with seed {run.config.seed}: {twin.path} and {run.path}; give a "
                "directory that holds one of them"
            )


def variant_of(config: dict[str, Any]) -> Variant:
    """The variant that a run's flat configuration is of."""
    # What comes with a controller is not named beside it.
    defaults = dict(default_keys(config[CONTROLLER])) | {CONTROLLER: controllers.DEFAULT}
    changes = tuple((key, str(config[key])) for key in METHOD_KEYS if config[key] != defaults[key])
    return Variant(str(config["policy"]), changes)
