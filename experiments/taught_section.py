"""The section of docs/results.md on what is learnt from a teacher, beside the paper's figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from experiments.committed import BESIDE, BESIDE_WORDS, RESULTS, figure, rows
from loco_mjx.compare import paper
from loco_mjx.compare.markup import markdown
from loco_mjx.config import DistillConfig
from loco_mjx.evaluation.display import NOTHING
from loco_mjx.scene.tasks import get_task

TAUGHT = """## Taught, on a CPU

`python -m experiments.taught` trains by `--method distill`: a teacher that sees what only a simulator knows learns by
PPO, and the policy imitates it from pixels; no PPO of its own. Where the method is `ppo`, the policy learnt from pixels
alone, on fewer samples, but each costs more. Collisions cost the teacher something, except where they are "free", in a
run of an earlier version; what is evaluated, and PPO's reward, is the paper's. Deterministic, {episodes} episodes of
{seconds:g} s in scenes neither has seen; means over seeds, ± their standard deviation. The paper's figures are by PPO
alone, after 15 million samples, five seeds. "Falls" is the share of episodes that end in one; on `mountain` "distance"
is, as in the paper, from start to end, so that a robot that runs past the summit and down the other side has the most,
"progress" is how much nearer the goal has come, and "at the goal" the share of episodes in which the robot came within
1 m of it; a dash: evaluated before there was such a figure, or without a goal. "Mean": the teacher and the policy are
the means of their parameters over iterations (`ppo.average`), "× 8": of a teacher with so many samples for each of the
policy's, instead of four, "falling": the teacher's learning rate falls to 0.
"""
TIMES = """The samples and minutes of each run, teacher and policy; the machine was shared with other work, so times are
upper bounds:
"""


def taught() -> str:
    """The section; nothing where there are no results."""
    found = sorted((RESULTS / "taught").glob("*/config.json"))
    if not found:
        return ""
    runs = [path.parent for path in found]
    groups: dict[tuple[str, str, str, str], list[dict[str, Any]]] = {}
    for run in runs:
        config = json.loads((run / "config.json").read_text())
        for path in sorted(run.glob("evaluation-*.json")):
            result = json.loads(path.read_text())
            method = _method(config, result["metrics"])
            groups.setdefault((method, result["policy"], result["trained_on"], result["task"]), []).append(result)
    results = [result for group in groups.values() for result in group]
    text = TAUGHT.format(episodes=_only({r["num_episodes"] for r in results}), seconds=40)
    head = [
        "method",
        "policy",
        "trained on",
        "evaluated on",
        "seeds",
        "distance",
        "progress",
        "at the goal",
        "falls",
        "collisions",
        *BESIDE_WORDS,
    ]
    head += ["paper: distance", "paper: collisions"]
    body = [_line(where, [result["metrics"] for result in group]) for where, group in groups.items()]
    times = markdown(["run", "teacher's samples", "policy's samples", "minutes"], [_times(run) for run in runs])
    return "\n".join([text, markdown(head, body), TIMES, times])


def _method(config: dict[str, Any], metrics: dict[str, Any]) -> str:
    """By which it was trained, and what was not as it usually is: collisions, if there are any, samples, the mean."""
    if config["method"] != "distill":
        return str(config["method"])
    distill, marks = config["distill"], []
    if not distill.get("teacher_collision", 0.0) and metrics["collisions"]["mean"]:
        marks.append("collisions free")
    if distill["teacher_ratio"] != DistillConfig.teacher_ratio:
        marks.append(f"× {distill['teacher_ratio']:g}")
    if config["ppo"].get("average", 0.0):
        marks.append("mean")
    if config["ppo"]["learning_rate_decay"]:
        marks.append("falling")
    return ", ".join(["distill", *marks])


def _line(where: tuple[str, str, str, str], metrics: list[dict[str, Any]]) -> list[str]:
    wanted = {"collisions": 0} | BESIDE
    printed = [_printed(*where[1:], metric) for metric in (paper.DISTANCE, paper.COLLISIONS)]
    goal = get_task(where[3]).toward_goal
    return [
        *where,
        str(len(metrics)),
        figure(metrics, "distance", 2),
        figure(metrics, "progress", 2) if goal else NOTHING,
        _share(metrics, "reached_goal") if goal else NOTHING,
        _share(metrics, "survived", inverse=True),
        *(figure(metrics, name, digits) for name, digits in wanted.items()),
        *printed,
    ]


def _share(metrics: list[dict[str, Any]], name: str, inverse: bool = False) -> str:
    """Mean over the seeds of a share of the episodes, or of the rest of them; a dash unless all have it."""
    if any(name not in one for one in metrics):
        return NOTHING
    mean = sum(one[name]["mean"] for one in metrics) / len(metrics)
    return f"{1.0 - mean if inverse else mean:.0%}"


def _printed(policy: str, trained_on: str, task: str, metric: str) -> str:
    """The policy's figure in the paper, or a dash."""
    for one in (printed for printed in paper.TABLES if printed is not paper.ABLATION):
        for i, column in enumerate(one.columns):
            if (column.trained_on, column.evaluated_on, column.metric) == (trained_on, task, metric):
                value = next(row.values[i] for row in one.rows if row.variant.policy == policy)
                return f"{value[0]} ± {value[1]}" if value else NOTHING
    return NOTHING


def _times(run: Path) -> list[str]:
    policy, path = rows(run / "metrics.csv")[-1], run / "teacher-metrics.csv"
    teacher = rows(path)[-1] if path.exists() else {"step": 0.0, "time/seconds": 0.0}
    minutes = (teacher["time/seconds"] + policy["time/seconds"]) / 60
    return [f"`{run.name}`", f"{teacher['step']:,.0f}", f"{policy['step']:,.0f}", f"{minutes:.0f}"]


def _only(values: set[Any]) -> Any:
    """The one value that all have."""
    (value,) = values
    return value
