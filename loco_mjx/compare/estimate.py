"""How long a sweep will take, before and while it runs."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence

from rich.table import Table

from loco_mjx.compare.cells import Cell, measured_rate
from loco_mjx.run import machine
from loco_mjx.run.progress import duration

Rates = Mapping[str, float | None]


def rates(cells: Sequence[Cell]) -> Rates:
    """Samples per second that cells will train at, by policy.

    What cells of the same policy did here, else what a CPU does; None where there is a GPU that nothing has run on.
    """
    from loco_mjx.cli.train import CPU_RATE

    found: dict[str, float | None] = {}
    for policy in dict.fromkeys(cell.variant.policy for cell in cells):
        group = [cell for cell in cells if cell.variant.policy == policy]
        on_cpu = CPU_RATE[group[0].config.env.observation.depth.enabled] * machine.cores()
        found[policy] = measured_rate(group) or (None if shutil.which("nvidia-smi") else on_cpu)
    return found


def seconds_left(cells: Sequence[Cell], known: Rates) -> float | None:
    """Time to train what is left of some cells; None if that is not known of one of them."""
    left = 0.0
    for cell in cells:
        rate = known[cell.variant.policy]
        if rate is None:
            return None
        left += (cell.samples - cell.done()) / rate
    return left


def overview(cells: Sequence[Cell], finished: Sequence[Cell]) -> Table:
    """What will run, and how long; one line per task and policy."""
    known = rates(cells)
    table = Table(title=_title(cells, finished, known), title_justify="left", caption=_caption(cells))
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


def _title(cells: Sequence[Cell], finished: Sequence[Cell], known: Rates) -> str:
    todo = [cell for cell in cells if cell not in finished]
    time = say_time(seconds_left(todo, known))
    return f"{len(cells)} runs, {len(finished)} of them finished; training: {time}"


def _caption(cells: Sequence[Cell]) -> str:
    """What every run is evaluated on at its end."""
    if all(cell.eval_tasks == (cell.task,) for cell in cells):
        where = "the task it is trained on"
    else:
        lists = dict.fromkeys(", ".join(cell.eval_tasks) for cell in cells)
        where = next(iter(lists)) if len(lists) == 1 else "the tasks of its experiment"
    return f"each evaluated on {where}, {cells[0].episodes} episodes"
