"""How long a sweep will take, before and while it runs: compiling, training, and evaluating."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from loco_mjx.compare.cells import Cell, measured
from loco_mjx.config import Config
from loco_mjx.run import settings
from loco_mjx.run.directory import TEACHER
from loco_mjx.run.progress import duration
from loco_mjx.run.variant import Variant

# Seconds, as measured on two cores; compilation uses one, so that more of them change little.
START = {False: 50.0, True: 110.0}  # of `train`, without and with depth: imports and compilation, no program cached
START_AGAIN = 25.0  # the same with the programs of another seed in the cache
EVALUATE = 25.0  # of `evaluate`
STEP = 0.0025  # a control step of few episodes side by side, on a CPU
EVALUATED = 4.0  # evaluating is so much faster than training, per sample


@dataclass(frozen=True)
class Pace:
    """How fast cells of a policy are trained.

    Attributes:
        rate: samples per second.
        start: seconds of a run before its first sample: imports and compilation.
        again: the same of further seeds.
        evaluating: whether evaluations while training come on top, or are in the rate.
        teacher: the same of its teacher, for method `distill`.
    """

    rate: float
    start: float
    again: float
    evaluating: bool
    teacher: Pace | None = None


Kind = tuple[str, str]  # a policy and the method by which it learns
Paces = Mapping[Kind, Pace | None]


def kind_of(cell: Cell) -> Kind:
    """What cells share that are trained equally fast."""
    return cell.config.policy, cell.config.method


def paces(cells: Sequence[Cell]) -> Paces:
    """How fast cells will be trained, by policy and method.

    Measured in cells that have run here, else estimated for a CPU; None if there is a GPU and nothing has run on it.
    """
    groups: dict[Kind, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(kind_of(cell), []).append(cell)
    return {kind: _pace(group) for kind, group in groups.items()}


def _pace(group: Sequence[Cell]) -> Pace | None:
    config = group[0].config
    own = _measured_or(settings.cpu_rate(config), config, [cell.path for cell in group])
    teacher = group[0].teacher
    if teacher is None or own is None:
        return own
    taught = _measured_or(settings.cpu_teacher_rate(teacher), teacher, [cell.path / TEACHER for cell in group])
    return None if taught is None else dataclasses.replace(own, teacher=taught)


def _measured_or(cpu_rate: float, config: Config, runs: Sequence[Path]) -> Pace | None:
    """The pace of runs: measured if they have run here, else estimated for a CPU; None if there is a GPU."""
    here = measured(runs)
    if here is not None:
        return Pace(here.rate, here.start, here.start, False)
    if shutil.which("nvidia-smi"):
        return None
    return Pace(cpu_rate, START[config.env.observation.depth.enabled], START_AGAIN, True)


def seconds_left(
    cells: Sequence[Cell],
    known: Paces,
    done: Mapping[str, int] | None = None,
    begun: Collection[str] = (),
) -> float | None:
    """Seconds to finish some cells, one after the other; None if the pace of one of them is not known.

    Args:
        cells: to finish.
        known: from :func:`paces`.
        done: samples trained so far, by a cell's name; None: as their curves have it.
        begun: names of cells that train by now, which have compiled.
    """
    left, compiled = 0.0, set[tuple[str, Variant]]()
    for cell in cells:
        pace = known[kind_of(cell)]
        if pace is None:
            return None
        samples = cell.samples - (cell.done() if done is None else done[cell.name])
        if samples > 0:
            again = (cell.task, cell.variant) in compiled
            left += _training(cell, cell.samples, samples, pace, again, cell.name in begun)
            left += _teaching(cell, pace.teacher, again)
            compiled.add((cell.task, cell.variant))
        left += len(cell.unevaluated()) * (EVALUATE + _episodes(cell, cell.episodes, pace))
    return left


def _training(cell: Cell, total: int, samples: int, pace: Pace, again: bool, begun: bool) -> float:
    """Seconds for the samples that are left of a total; `again`: programs are in the cache, `begun`: in the process."""
    start = 0.0 if begun else pace.again if again else pace.start
    evaluations = samples / total * _evaluations(cell, total, pace) if pace.evaluating else 0.0
    return start + samples / pace.rate + evaluations


def _teaching(cell: Cell, pace: Pace | None, again: bool) -> float:
    """Seconds for what is left of a cell's teacher."""
    samples = 0 if pace is None else cell.teacher_samples - cell.teacher_done()
    if pace is None or samples <= 0:
        return 0.0
    return _training(cell, cell.teacher_samples, samples, pace, again, cell.teacher_done() > 0)


def _evaluations(cell: Cell, total: int, pace: Pace) -> float:
    """Seconds of the evaluations while a cell, or its teacher, trains on a total of samples."""
    if not cell.loop.evaluations:
        return 0.0
    count = min(cell.loop.evaluations + 1, total // cell.config.ppo.samples_per_iteration)
    return count * _episodes(cell, cell.loop.evaluation_episodes, pace)


def _episodes(cell: Cell, episodes: int, pace: Pace) -> float:
    """Seconds of episodes side by side, if none ends early."""
    return cell.config.env.horizon * max(STEP, episodes / (EVALUATED * pace.rate))


def overview(cells: Sequence[Cell], finished: Sequence[Cell]) -> Table:
    """What will run, and how long; one line per task and policy."""
    known = paces(cells)
    table = Table(
        title=_title(cells, finished, known), title_justify="left", caption=_caption(cells), caption_justify="left"
    )
    table.add_column("task", no_wrap=True)
    table.add_column("policy", overflow="fold")
    table.add_column("seeds", overflow="fold", justify="right")
    for name in ("samples each", "finished", "time"):
        table.add_column(name, no_wrap=True, justify="right")
    for task, variant in dict.fromkeys((cell.task, cell.variant) for cell in cells):
        group = [cell for cell in cells if (cell.task, cell.variant) == (task, variant)]
        todo = [cell for cell in group if cell not in finished]
        table.add_row(
            task,
            variant.label,
            ",".join(str(cell.seed) for cell in group),
            f"{group[0].samples:,}",
            f"{len(group) - len(todo)}/{len(group)}",
            say_time(seconds_left(todo, known)).removeprefix("about "),
        )
    return table


def say_time(seconds: float | None) -> str:
    """A duration, or that it is not known yet."""
    return "not known yet" if seconds is None else "done" if seconds == 0 else f"about {duration(seconds)}"


def _title(cells: Sequence[Cell], finished: Sequence[Cell], known: Paces) -> str:
    todo = [cell for cell in cells if cell not in finished]
    time = say_time(seconds_left(todo, known))
    return f"{len(cells)} runs, {len(finished)} of them finished; time left: {time}"


def _caption(cells: Sequence[Cell]) -> str:
    """What every run is evaluated on at its end, and what the times are."""
    if all(cell.eval_tasks == (cell.task,) for cell in cells):
        where = "the task it is trained on"
    else:
        wheres = dict.fromkeys(", ".join(cell.eval_tasks) for cell in cells)
        where = next(iter(wheres)) if len(wheres) == 1 else "the tasks of its experiment"
    times = "times are estimates, compilation and evaluations included"
    return f"each evaluated on {where}, {cells[0].episodes} episodes; {times}"
