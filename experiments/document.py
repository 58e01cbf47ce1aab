"""Writes docs/results.md and its curves from the committed results: ``python -m experiments.document``."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results" / "cpu"
CURVES = ROOT / "docs" / "learning.png"
TAIL = 10  # iterations that a curve's end is averaged over

INTRO = """# Results

Written by `python -m experiments.document` from the files under `experiments/results/`; nothing here is typed by hand.
"""
LEARNING = """## Learning, on a CPU

`python -m experiments.learning` trains these with the `fast` preset and evaluates each on {episodes}
episodes of 1,000 control steps in scenes it has not seen. Distances in m, lengths in control steps. "At the start"
is the same policy after its first iteration: acting by its mean it stands still, exploring it falls over.
"Exploring" is the policy as it acts in training, drawing from its Gaussian; the mean of the last {tail} iterations.
The runs shared the machine with other work: their times are upper bounds.

![Distance and episode length over samples](learning.png)
"""
COMPARISON = """## Policies on `thin`, against the paper's ordering

The same runs, on the task they were trained on and on `wide`, which they have never seen: mean ± standard deviation
over seeds of the mean of {episodes} deterministic episodes. The paper's figures (its table 1: trained on thin
obstacles, evaluated on wide ones) stand on 15 million samples and five seeds, ours on the samples above: what is
compared is the order.
"""
SIMCHECK = """## The exported policy in C MuJoCo and in MJX

`python -m experiments.simcheck` exports these policies and compares (`loco-mjx simcheck POLICY --json`): the same ONNX
file, scenes and starts; C MuJoCo with the full scene, every obstacle a real geom, and depth by `mj_multiRay`. The
difference is C − MJX with the standard error of the paired mean.
"""
SPEED = """## Speed, on a CPU

`python -m experiments.speed`. Absolute times vary from machine to machine; a peer is measured in the same run, on
the same scenes, with as many threads.
"""


def rows(path: Path) -> list[dict[str, float]]:
    """A metrics.csv as numbers; empty cells are left out."""
    with path.open() as file:
        return [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(file)]


def runs() -> dict[str, Path]:
    """The learning runs that have results, by name."""
    return {path.parent.name: path.parent for path in sorted((RESULTS / "learning").glob("*/evaluation.json"))}


def table(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def machine(info: dict[str, Any]) -> str:
    """One line: processor, devices, versions, commit."""
    versions = ", ".join(f"{name} {info['versions'][name]}" for name in ("python", "jax", "mujoco-mjx", "brax"))
    where = f"{info['machine']['system']}, {info['devices']['count']} {info['devices']['kind']} devices"
    return f"{where}; {versions}; commit {info['git']['commit'][:10]}"


def _curve_end(curve: list[dict[str, float]], name: str) -> float:
    values = [row[name] for row in curve if name in row][-TAIL:]
    return sum(values) / len(values)


def learning_row(name: str, path: Path) -> list[str]:
    """One run's line of the table."""
    curve = rows(path / "metrics.csv")
    result = json.loads((path / "evaluation.json").read_text())
    still, metrics = result["standing_still"], result["metrics"]
    first = curve[0]
    return [
        name,
        f"{result['samples']:,}",
        f"{curve[-1]['time/seconds'] / 60:.0f} min",
        f"{metrics['distance']['mean']:.2f} ± {metrics['distance']['std']:.2f}",
        f"{metrics['length']['mean']:.0f}",
        f"{metrics['collisions']['mean']:.0f}",
        f"{first['eval/distance']:.2f}",
        f"{still['distance']:.2f}",
        f"{first['episode/distance']:.2f} → {_curve_end(curve, 'episode/distance'):.2f}",
        f"{first['episode/length']:.0f} → {_curve_end(curve, 'episode/length'):.0f}",
    ]


def learning() -> str:
    """The section on learning."""
    found = runs()
    head = ["run", "samples", "time", "distance", "length", "collisions", "at the start", "standing still"]
    head += ["exploring: distance", "exploring: length"]
    text = LEARNING.format(episodes=len_episodes(found), tail=TAIL)
    text += "\n" + table(head, [learning_row(name, path) for name, path in found.items()])
    for name, path in found.items():
        physics = json.loads((path / "config.json").read_text())["env"]["physics"]
        solver = f"solver {physics['iterations']} × {physics['ls_iterations']} iterations"
        text += f"\n- `{name}`: {solver}; {machine(json.loads((path / 'info.json').read_text()))}"
    return text + "\n"


def comparison() -> str:
    """The section on policies trained on `thin`."""
    from loco_mjx.compare import paper

    groups = {
        label: [path for name, path in runs().items() if name.startswith(f"thin-{variant.policy}-seed")]
        for label, variant in paper.POLICIES.items()
    }
    groups = {label: paths for label, paths in groups.items() if paths}
    columns = [(file, metric) for file in ("evaluation", "evaluation-wide") for metric in ("distance", "collisions")]
    ours = {label: [_over_seeds(paths, *column) for column in columns] for label, paths in groups.items()}
    far = {label: values[2] for label, values in ours.items()}  # distances on wide
    printed = {row.label: (row.values[1], row.values[3]) for row in paper.GENERALIZATION.rows}
    head = ["policy", "seeds", "distance", "collisions", "distance on wide", "collisions on wide"]
    head += ["paper: distance on wide", "paper: collisions on wide"]
    body = [
        [paper.POLICIES[label].policy, str(len(groups[label])), *(_spread(x, 1 - i % 2) for i, x in enumerate(figures))]
        + [f"{x[0]} ± {x[1]}" if x else "—" for x in printed[label]]
        for label, figures in ours.items()
    ]
    text = COMPARISON.format(episodes=len_episodes(runs())) + "\n" + table(head, body)
    return text + "\n" + _orders(far, {label: (printed[label][0] or (0.0,))[0] for label in ours}) + "\n"


def _orders(ours: dict[str, list[float]], theirs: dict[str, float]) -> str:
    """What our seeds say about each pair of policies that the paper puts in an order."""
    from loco_mjx.compare import paper

    names = {label: paper.POLICIES[label].policy for label in ours}
    pairs = [(a, b) for a in ours for b in ours if theirs[a] > theirs[b]]
    shown = [(a, b) for a, b in pairs if min(ours[a]) > max(ours[b])]
    against = [(a, b) for a, b in pairs if max(ours[a]) < min(ours[b])]
    open_ = [pair for pair in pairs if pair not in shown + against]
    said = lambda found: "; ".join(f"{names[a]} > {names[b]}" for a, b in found) or "none"  # noqa: E731
    return (
        "Of the paper's order of distances on `wide`, pair by pair: "
        f"every seed of ours agrees on {said(shown)}. Every seed contradicts {said(against)}. "
        f"Our seeds do not decide {said(open_)}."
    )


def _over_seeds(paths: list[Path], file: str, metric: str) -> list[float]:
    """The mean over episodes, of each seed."""
    return [json.loads((path / f"{file}.json").read_text())["metrics"][metric]["mean"] for path in paths]


def _spread(values: list[float], digits: int) -> str:
    """Mean ± standard deviation over seeds."""
    mean = sum(values) / len(values)
    std = (sum((value - mean) ** 2 for value in values) / len(values)) ** 0.5
    return f"{mean:.{digits}f} ± {std:.{digits}f}" if len(values) > 1 else f"{mean:.{digits}f}"


def simcheck() -> str:
    """The section on sim-to-sim."""
    head = ["policy", "task", "episodes", "metric", "C MuJoCo", "MJX", "ratio", "difference"]
    body = []
    for path in sorted((RESULTS / "simcheck").glob("*.json")):
        result = json.loads(path.read_text())
        for name in ("distance", "collisions", "return", "length"):
            m = result["metrics"][name]
            body.append(
                [result["policy"], result["task"], str(result["num_episodes"]), name]
                + [f"{m[f'{side}_mean']:.2f} ± {m[f'{side}_std']:.2f}" for side in ("c", "mjx")]
                + ["—" if m["ratio"] is None else f"{m['ratio']:.3f}"]
                + [f"{m['difference']:+.2f} ± {m['standard_error']:.2f}"]
            )
    return SIMCHECK + "\n" + table(head, body) if body else ""


def len_episodes(found: dict[str, Path]) -> int:
    """How many episodes the evaluations have; they agree."""
    counts = {json.loads((p / "evaluation.json").read_text())["num_episodes"] for p in found.values()}
    if len(counts) != 1:
        raise SystemExit(f"the evaluations have different numbers of episodes: {sorted(counts)}")
    return counts.pop()


def speed() -> str:
    """The section on speed."""
    body = []
    for path in sorted((RESULTS / "bench").glob("*.json")):
        result = json.loads(path.read_text())
        peer = result.get("peer")
        if "single" in result:
            peer = {"name": "one seed alone", "per_second": result["single"]["per_second"]}
        body.append(
            [
                f"`{result['command']}`",
                f"{result['per_second']:,.0f}",
                f"{peer['name']} {peer['per_second']:,.0f}" if peer else "",
                f"{result['per_second'] / peer['per_second']:.1f}×" if peer else "",
                f"{result['compile_seconds']:.0f} s",
                str(result["num_envs"]),
                str(result["devices"]),
            ]
        )
    head = ["command", "per second", "peer per second", "ratio", "compile", "environments", "devices"]
    return SPEED + "\n" + table(head, body)


def curves() -> None:
    """Draws distance and length over samples of every learning run."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), constrained_layout=True)
    for i, (name, path) in enumerate(runs().items()):
        curve, color = rows(path / "metrics.csv"), f"C{i}"
        for key, style, label in (("eval/distance", "o-", f"{name}, mean action"), ("episode/distance", "-", None)):
            points = [(row["step"] / 1e6, row[key]) for row in curve if key in row]
            alpha = 1.0 if label else 0.4
            left.plot(*zip(*points, strict=True), style, color=color, alpha=alpha, label=label, markersize=4)
        points = [(row["step"] / 1e6, row["episode/length"]) for row in curve if "episode/length" in row]
        right.plot(*zip(*points, strict=True), color=color, label=name)
    left.set(xlabel="samples, millions", ylabel="distance per episode, m", title="faint: exploring")
    right.set(xlabel="samples, millions", ylabel="episode length, control steps", title="exploring")
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(CURVES, dpi=110)


def main() -> None:
    """Writes the document and its figure."""
    curves()
    (ROOT / "docs" / "results.md").write_text(
        "\n".join(part for part in (INTRO, learning(), comparison(), simcheck(), speed()) if part)
    )


if __name__ == "__main__":
    main()
