"""The section of docs/results.md on policies trained on `thin`, against the paper's ordering."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.committed import len_episodes, runs, table
from loco_mjx.compare import paper

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
    return table(head, body) + "\n" + _orders(far, {label: (printed[label][0] or (0.0,))[0] for label in ours}) + "\n"


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


def _over_seeds(paths: list[Path], file: str, metric: str) -> list[float]:
    """The mean over episodes, of each seed."""
    return [json.loads((path / f"{file}.json").read_text())["metrics"][metric]["mean"] for path in paths]


def _spread(values: list[float], digits: int) -> str:
    """Mean ± standard deviation over seeds."""
    mean = sum(values) / len(values)
    std = (sum((value - mean) ** 2 for value in values) / len(values)) ** 0.5
    return f"{mean:.{digits}f} ± {std:.{digits}f}" if len(values) > 1 else f"{mean:.{digits}f}"
