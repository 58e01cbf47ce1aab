"""The section of docs/results.md on policies over the whole-body controller, with its curves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from experiments.committed import RESULTS, rows
from loco_mjx.compare.markup import markdown
from loco_mjx.evaluation.display import NOTHING

FOLDER = RESULTS / "high_level"
CURVES = "high_level.png"
INTRO = """## Policies over the whole-body controller, on a CPU

`python -m experiments.high_level` trains four on `thin` with the `fast` preset: the paper's figure of its vision-guided
whole-body controller. "Transformer" and "CNN" see depth alone, or depth with velocity and attitude. Their rewards and
episodes (25 s) are not those of joint targets and are not to be compared with them. The runs shared the machine with
other work: their times are upper bounds.
"""
FIGURE = f"""![Return over samples, acting by the mean]({CURVES})
"""
COMPARED = """**Simulation, not the real world.** The paper's last two tables are of a real A1; ours are of the A1 in
C MuJoCo, {seconds:g} s each through the deployment's loop (`loco-mjx deploy`), in `indoor` and `forest`, which stand in
for the paper's two places, and on three tasks; {episodes} scenes each, the same ones for all. Distance is Euclidean,
from start to end or to where the robot was stopped. A collision is a contact with an obstacle or a wall that comes
after {apart:g} s without any. The paper's controller sees depth alone, through a CNN (`visual-cnn`); its "Ours" are
joint targets, here the policy `thin` that comes with the package, taught on {taught} samples. "Stopped": runs that the
loop ended before their time.
"""
PAPER = {  # of the real robot: distance, m, and collisions, mean and standard deviation
    ("visual-cnn", "indoor"): ((7.5, 1.5), (3.4, 0.8)),
    ("end-to-end", "indoor"): ((9.6, 2.2), (0.3, 0.5)),
    ("visual-cnn", "forest"): ((11.6, 3.5), (1.9, 0.8)),
    ("end-to-end", "forest"): ((9.6, 2.0), (0.0, 0.0)),
}
TASKS = ("indoor", "forest", "thin", "wide", "moving")
SEES = {
    "loco-transformer": ("transformer", "depth, velocity, attitude"),
    "state-depth-concat": ("CNN", "depth, velocity, attitude"),
    "depth-only": ("transformer", "depth"),
    "visual-cnn": ("CNN", "depth"),
}


def high_level() -> str:
    """The section; nothing where there are no results."""
    runs = sorted((FOLDER / "runs").glob("*/metrics.csv"))
    if not runs:
        return ""
    head = ["policy", "", "sees", "samples", "time", "samples/s", "return", "distance", "unsolved programs"]
    parts = [INTRO, FIGURE, markdown(head, [_run(path.parent) for path in runs]), _compared()]
    return "\n".join(part for part in parts if part)


def _run(run: Path) -> list[str]:
    """One run's line: how long it took, and its last evaluation while training."""
    config, curve = json.loads((run / "config.json").read_text()), rows(run / "metrics.csv")
    last = [row for row in curve if "eval/return" in row][-1]
    rate = float(np.median([row["time/samples_per_second"] for row in curve]))
    unsolved = sum(row["step/unsolved"] for row in curve) / len(curve) / 10
    return [
        *(f"`{config['policy']}`", *SEES[config["policy"]], f"{curve[-1]['step']:,.0f}"),
        *(f"{curve[-1]['time/seconds'] / 60:.0f} min", f"{rate:.0f}"),
        *(f"{last['eval/return']:.1f}", f"{last['eval/distance']:.2f} m", f"{unsolved:.2%}"),
    ]


def _compared() -> str:
    """The paper's last two tables, and tasks beside them."""
    found = {
        (result["name"], result["task"]): result
        for result in (json.loads(path.read_text()) for path in sorted((FOLDER / "compare").glob("*.json")))
    }
    if not found:
        return ""
    one = next(iter(found.values()))
    taught = next((f"{r['samples']:,}" for r in found.values() if r["name"] == "end-to-end"), NOTHING)
    counts = sorted({len(result["rows"]) for result in found.values()})
    episodes = "–".join(map(str, dict.fromkeys((counts[0], counts[-1]))))
    said = COMPARED.format(episodes=episodes, taught=taught, apart=one["apart"], seconds=one["seconds"])
    names = dict.fromkeys(("end-to-end", *SEES))
    body = [_line(found[name, task]) for task in TASKS for name in names if (name, task) in found]
    head = ["scene", "commands", "policy", "distance, m", "collisions", "stopped"]
    head += ["paper, real A1: distance, m", "paper, real A1: collisions"]
    return said + "\n" + markdown(head, body)


def _line(result: dict[str, Any]) -> list[str]:
    values = {key: [row[key] for row in result["rows"]] for key in ("distance", "collisions")}
    ours = [f"{np.mean(values[key]):.1f} ± {np.std(values[key]):.1f}" for key in values]
    printed = PAPER.get((result["name"], result["task"]))
    theirs = [NOTHING] * 2 if printed is None else [f"{mean} ± {std}" for mean, std in printed]
    stopped = sum(row["stopped"] is not None for row in result["rows"])
    what = "joint targets" if result["controller"] == "pd" else "walk"
    return [result["task"], what, f"`{result['policy']}`", *ours, f"{stopped} of {len(result['rows'])}", *theirs]


def curves(docs: Path) -> None:
    """Draws the mean policy's return over samples, a line per policy; nothing where there are no results."""
    runs = sorted((FOLDER / "runs").glob("*/metrics.csv"))
    if not runs:
        return
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True, constrained_layout=True)
    for path in runs:
        network, sees = SEES[json.loads((path.parent / "config.json").read_text())["policy"]]
        axis = axes[int(sees != "depth")]
        color = {"transformer": "C0", "CNN": "C1"}[network]
        curve = rows(path)
        for name, style, alpha in (("eval/return", "o-", 1.0), ("episode/return", "-", 0.3)):
            points = [(row["step"] / 1e6, row[name]) for row in curve if name in row]
            label = network if name == "eval/return" else None
            axis.plot(*zip(*points, strict=True), style, color=color, alpha=alpha, markersize=4, label=label)
        axis.set(title=sees, xlabel="samples, millions")
    for axis in axes:
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=8)
    axes[0].set(ylabel="return; faint: exploring")
    figure.savefig(docs / CURVES, dpi=110)
    plt.close(figure)
