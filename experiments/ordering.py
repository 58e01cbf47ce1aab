"""The section of docs/results.md on policies trained on `thin`, against the paper's ordering."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.committed import BESIDE, BESIDE_WORDS, figure, len_episodes, runs
from loco_mjx.compare import paper
from loco_mjx.compare.markup import markdown

FILES = {"thin": "evaluation", "wide": "evaluation-wide"}  # what the policies were evaluated on
COMPARISON = """## Policies on `thin`, against the paper's ordering

The same runs, on the task they were trained on and on `wide`, which they have never seen: mean ± standard deviation
over seeds of the mean of {episodes} deterministic episodes. The paper's figures (its table 1: trained on thin
obstacles, evaluated on wide ones) stand on 15 million samples and five seeds, ours on fewer, and on the `fast` preset
instead of the paper's hyper-parameters (`paper`): what is compared is the order.
"""


def comparison() -> str:
    """The section on policies trained on `thin`, by the number of samples."""
    found = {name: path for name, path in runs().items() if name.startswith("thin-")}
    samples = {name: json.loads((path / "evaluation.json").read_text())["samples"] for name, path in found.items()}
    parts = [COMPARISON.format(episodes=len_episodes(runs()))]
    for count in sorted(set(samples.values())):
        parts.append(f"### After {count:,} samples\n")
        parts.append(_compared({name: path for name, path in found.items() if samples[name] == count}))
    return "\n".join(parts)


def _compared(found: dict[str, Path]) -> str:
    """The policies that have been trained for as long, and the paper's order."""
    groups = {
        label: [path for name, path in found.items() if name.startswith(f"thin-{variant.policy}-seed")]
        for label, variant in paper.POLICIES.items()
    }
    groups = {label: paths for label, paths in groups.items() if paths}
    metrics = {
        task: {label: [_metrics(path / f"{file}.json") for path in paths] for label, paths in groups.items()}
        for task, file in FILES.items()
    }
    far = {label: [one["distance"]["mean"] for one in found] for label, found in metrics["wide"].items()}
    printed = {row.label: (row.values[1], row.values[3]) for row in paper.GENERALIZATION.rows}
    head = ["policy", "seeds", "distance", "collisions", *BESIDE_WORDS]
    parts = []
    for task, ours in metrics.items():
        body = [_figures(paper.POLICIES[label].policy, found) for label, found in ours.items()]
        if task == "wide":
            head += ["paper: distance", "paper: collisions"]
            for row, label in zip(body, ours, strict=True):
                row += [f"{x[0]} ± {x[1]}" if x else "—" for x in printed[label]]
        parts.append(f"On `{task}`:\n\n{markdown(head, body)}")
    order = _orders(far, {label: (printed[label][0] or (0.0,))[0] for label in groups})
    return "\n".join([*parts, order + "\n"])


def _figures(policy: str, metrics: list[dict[str, dict[str, float]]]) -> list[str]:
    """A policy's line: over its seeds."""
    wanted = {"distance": 1, "collisions": 0} | BESIDE
    return [policy, str(len(metrics)), *(figure(metrics, name, digits) for name, digits in wanted.items())]


def _orders(ours: dict[str, list[float]], theirs: dict[str, float]) -> str:
    """What our seeds say about each pair of policies that the paper puts in an order."""
    names = {label: paper.POLICIES[label].policy for label in ours}
    pairs = [(a, b) for a in ours for b in ours if theirs[a] > theirs[b]]
    shown = [(a, b) for a, b in pairs if min(ours[a]) > max(ours[b])]
    against = [(a, b) for a, b in pairs if max(ours[a]) < min(ours[b])]
    open_ = [pair for pair in pairs if pair not in shown + against]
    parts = [("every seed of ours agrees on", shown), ("every seed contradicts", against), ("undecided is", open_)]
    said = [f"{what} {', '.join(f'{names[a]} > {names[b]}' for a, b in found)}" for what, found in parts if found]
    return f"Of the paper's order of distances on `wide`, pair by pair: {'; '.join(said)}."


def _metrics(path: Path) -> dict[str, dict[str, float]]:
    """Mean and deviation of each metric over the episodes of an evaluation."""
    return dict(json.loads(path.read_text())["metrics"])
