"""What people are shown of an evaluation, of figures as runs leave them."""

import copy
import io

from rich.console import Console

from loco_mjx.evaluation import multi_seed, report
from loco_mjx.evaluation.display import order
from tests.refusals import says

ZERO = {"mean": 0.0, "std": 0.0}
METRICS = {
    "collisions": {"mean": 42.3, "std": 102.9},
    "contacts": {"mean": 42.4, "std": 102.9},
    "distance": {"mean": 39.94, "std": 6.3},
    "length": {"mean": 950.0, "std": 10.0},
    "nonfinite": ZERO,
    "progress": {"mean": 39.94, "std": 6.3},
    "return": {"mean": 992.2, "std": 138.2},
    "reward/alive": {"mean": 95.0, "std": 1.0},
    "reward/sphere": ZERO,
    "speed": {"mean": 1.0, "std": 0.158},
    "spheres": ZERO,
    "at_goal": ZERO,
    "reached_goal": ZERO,
    "survived": {"mean": 0.75, "std": 0.433},
    "distance_16s": {"mean": 15.5, "std": 1.0},
    "collisions_16s": {"mean": 20.0, "std": 3.0},
    "collisions_per_metre": {"mean": 1.06, "std": 2.5},
}
RESULT = {
    **{"policy": "loco-transformer", "trained_on": "thin", "samples": 8192, "task": "thin", "num_episodes": 4},
    **{"deterministic": True, "randomized": False, "metrics": METRICS},
}


def page(table):
    console = Console(file=io.StringIO(), width=160)
    console.print(table)
    return console.file.getvalue()


def labels(result, table=report.table):
    return [line.split("│")[1].strip() for line in page(table(result)).splitlines() if line.startswith("│")]


def test_what_matters_comes_first_and_zeros_only_by_name():
    assert labels(RESULT) == [
        *("distance", "collisions", "collisions per metre", "mean speed", "return", "length", "falls"),
        *("distance, first 16 s", "collisions, first 16 s", "contacts", "reward/alive"),
    ]
    text = page(report.table(RESULT))
    assert says(text, "zero spheres nonfinite reward/sphere")
    (falls,) = [line for line in text.splitlines() if "falls" in line]
    assert says(falls, "0.25 0.43")


def test_what_a_task_is_about_is_shown_even_at_zero():
    shown = labels(RESULT | {"task": "wide-sphere"})
    assert "spheres" in shown and "reward/sphere" in shown
    metrics = METRICS | {"progress": {"mean": 8.0, "std": 1.0}, "contacts/dropped": {"mean": 0.5, "std": 0.1}}
    shown = labels(RESULT | {"task": "mountain", "metrics": metrics})
    assert "progress to the goal" in shown and "contacts/dropped" in shown
    assert "came within 1 m of the goal" in shown and "within 1 m of the goal" not in shown


def test_a_figure_that_there_is_not_is_a_dash():
    metrics = {name: value for name, value in METRICS.items() if name != "collisions_per_metre"}
    (line,) = [line for line in page(report.table(RESULT | {"metrics": metrics})).splitlines() if "per metre" in line]
    assert line.split("│")[2].strip() == "—"


def test_seeds_are_shown_in_the_same_order():
    metrics = copy.deepcopy(METRICS)
    for value in metrics.values():
        value["seeds"] = [value["mean"] - 0.1, value["mean"] + 0.1]
    del metrics["collisions_per_metre"]
    result = RESULT | {"metrics": metrics, "seeds_trained": [3, 4]}
    assert labels(result, multi_seed.table) == labels(RESULT)
    text = page(multi_seed.table(result))
    (falls,) = [line for line in text.splitlines() if "falls" in line]
    assert [cell.strip() for cell in falls.split("│")[4:6]] == ["0.35", "0.15"]
    (ratio,) = [line for line in text.splitlines() if "per metre" in line]
    assert [cell.strip() for cell in ratio.split("│")[2:6]] == ["—", "", "—", "—"]


def test_every_metric_is_shown_or_named():
    shown, zero = order(METRICS, "thin")
    without_goal = {"progress", "at_goal", "reached_goal"}  # the first is the distance then
    assert {one.name for one in shown} | set(zero) | without_goal == set(METRICS)
    assert without_goal.isdisjoint(zero)
