"""Writes docs/results.md and its curves from the committed results: ``python -m experiments.document``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from experiments import averaging, high_level_section, needles, teachers
from experiments.committed import BESIDE, BESIDE_WORDS, RESULTS, figure, len_episodes, rows, runs
from experiments.ordering import comparison
from experiments.robots_section import robots, whole_body
from experiments.taught_section import taught
from loco_mjx.compare.markup import markdown

ROOT = Path(__file__).parents[1]
CURVES = ROOT / "docs" / "learning.png"
TAIL = 10  # iterations that a curve's end is averaged over

INTRO = """# Results

Written by `python -m experiments.document` from the files under `experiments/results/`; nothing here is typed by hand.
"""
LEARNING = """## Learning, on a CPU

`python -m experiments.learning` trains these with the `fast` preset and evaluates each on {episodes}
episodes of 1,000 control steps in scenes it has not seen. Distances in m, speed in m/s, lengths in control steps; the
first 16 s are what 1,000 steps of the authors' code last; a dash: evaluated before there was such a figure. "At the
start" is the same policy after its first iteration: acting by its mean it stands still, exploring it falls over.
"Exploring" is the policy as it acts in training, drawing from its Gaussian; the mean of the last {tail} iterations.
The runs shared the machine with other work: their times are upper bounds. No run on a GPU has been measured.
`make paper` uses another preset, `paper`, and 15 million samples a run: no such run is published here.

All of these runs are by PPO alone, and older than the present courses and contacts: the obstacles of `thin` and `wide`
ended at 28.5 m and 51 m, beyond which a distance measures open floor (now 73 m), and knees and sliding feet were
modelled less well.

![Distance and episode length over samples](learning.png)
"""
SIMCHECK = """## The exported policy in C MuJoCo and in MJX

`python -m experiments.simcheck NAME ...` exports these policies and compares (`loco-mjx simcheck POLICY --json`): the
same ONNX file, scenes and starts; C MuJoCo with the full scene, every obstacle a real geom, and depth by
`mj_multiRay`. The difference is C − MJX with the standard error of the paired mean. On a heightfield C's feet have the
plane beneath them, as in training; "C's prisms": its own contacts, which push a foot sideways that is deeper in the
ground than its radius (`loco_mjx/deploy/terrain_contacts.py`), so that robots trip over nothing.
"""
REPLAY = """Episodes of 40 s with contacts are chaotic: pairs part, and the means of so few are as uncertain as the
errors say. Seconds of them are not: every fourth second of MJX's episodes (solver {solver}) was run again in C from
the same state with the same commands; distance in m from start to end of {seconds:g} s, contacts in control steps.
What the policy would have commanded on C's observations and images of these seconds, and what it did command, differ
as below.
"""
SPEED = """## Speed, on a CPU

`python -m experiments.speed`. Absolute times vary from machine to machine; a peer is measured in the same run, on
the same scenes, with as many threads.
"""


RATIOS = """## What changes have cost

`python -m experiments.ratio` measures two commits in turn; per second after the change over per second before it.
"""


def machine(info: dict[str, Any]) -> str:
    """One line: processor, devices, versions, commit."""
    names = ("python", "jax", "mujoco-mjx", "brax")  # the last one only where results are from when it was needed
    versions = ", ".join(f"{name} {info['versions'][name]}" for name in names if name in info["versions"])
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
        *(figure([metrics], name, digits) for name, digits in BESIDE.items()),
        f"{first['eval/distance']:.2f}",
        f"{still['distance']:.2f}",
        f"{first['episode/distance']:.2f} → {_curve_end(curve, 'episode/distance'):.2f}",
        f"{first['episode/length']:.0f} → {_curve_end(curve, 'episode/length'):.0f}",
    ]


def learning() -> str:
    """The section on learning."""
    found = runs()
    head = [
        "run",
        "samples",
        "time",
        "distance",
        "length",
        "collisions",
        *BESIDE_WORDS,
        "at the start",
        "standing still",
    ]
    head += ["exploring: distance", "exploring: length"]
    text = LEARNING.format(episodes=len_episodes(found), tail=TAIL)
    text += "\n" + markdown(head, [learning_row(name, path) for name, path in found.items()])
    origins: dict[str, list[str]] = {}
    for name, path in found.items():
        physics = json.loads((path / "config.json").read_text())["env"]["physics"]
        solver = f"solver {physics['iterations']} × {physics['ls_iterations']} iterations"
        origins.setdefault(f"{solver}; {machine(json.loads((path / 'info.json').read_text()))}", []).append(name)
    for origin, names in origins.items():
        text += f"\n- {', '.join(f'`{name}`' for name in names)}: {origin}"
    return text + "\n"


def simcheck() -> str:
    """The section on sim-to-sim."""
    found = [json.loads(path.read_text()) for path in sorted((RESULTS / "simcheck").glob("*.json"))]
    if not found:
        return ""
    head = ["policy", "samples", "task", "episodes", "metric", "C MuJoCo", "MJX", "ratio", "difference"]
    body = [_sides(r, r["metrics"], name, 2) for r in found for name in ("distance", "collisions", "return", "length")]
    seconds = [r for r in found if r["replay"]["windows"]]  # an episode may end before its first
    again = [_sides(r, r["replay"], name, 4) for r in seconds for name in ("distance", "contacts")]
    for row, result in zip(again, [r for r in seconds for _ in range(2)], strict=True):
        row[3] = f"{result['replay']['windows']:,}"
    told = [(r, r["replay"].get("targets")) for r in seconds]
    away = [f"{r['policy']} on {_where(r)} {targets['mean']:.1e} rad" for r, targets in told if targets]
    solvers = {f"{r['physics']['iterations']} × {r['physics']['ls_iterations']}" for r in found}
    said = REPLAY.format(solver=" or ".join(sorted(solvers)), seconds=found[0]["replay"]["seconds"])
    replays = markdown([*head[:3], "seconds", *head[4:]], again)
    return "\n".join([SIMCHECK, markdown(head, body), said, replays, f"Targets differ by: {'; '.join(away)}.\n"])


def _sides(result: dict[str, Any], metrics: dict[str, Any], name: str, digits: int) -> list[str]:
    """A metric of both sides."""
    m = metrics[name]
    return [
        *(result["policy"], f"{result['samples']:,}", _where(result), str(result["num_episodes"]), name),
        *(f"{m[f'{side}_mean']:.{digits}f} ± {m[f'{side}_std']:.{digits}f}" for side in ("c", "mjx")),
        "—" if m["ratio"] is None else f"{m['ratio']:.{digits + 1}f}",
        f"{m['difference']:+.{digits}f}"
        + (f" ± {m['standard_error']:.{digits}f}" if m["standard_error"] is not None else ""),
    ]


def _where(result: dict[str, Any]) -> str:
    return result["task"] + (", C's prisms" if result.get("prisms") else "")


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
    return SPEED + "\n" + markdown(head, body)


def ratios() -> str:
    """The section on what changes have cost; nothing where none was measured."""
    body = []
    for path in sorted((RESULTS / "ratio").glob("*.json")):
        result = json.loads(path.read_text())
        parts = {name: part for name, part in result.items() if isinstance(part, dict)}
        commits = f"{result['old'][:7]} → {result['new'][:7]}"
        body += [[path.stem, commits, f"`{name}`", f"{part['ratio']:.3f}"] for name, part in parts.items()]
    return RATIOS + "\n" + markdown(["change", "commits", "what", "ratio"], body) if body else ""


def curves() -> None:
    """Draws distance and length over samples: a line per run, a colour per task and policy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), constrained_layout=True)
    colors: dict[str, str] = {}
    for name, path in _longest(runs()).items():
        curve, method = rows(path / "metrics.csv"), name.split("-seed")[0]
        label = None if method in colors else method
        color = colors.setdefault(method, f"C{len(colors)}")
        for axis, key, style, alpha in (
            (left, "eval/distance", "o-", 1.0),
            (left, "episode/distance", "-", 0.3),
            (right, "episode/length", "-", 1.0),
        ):
            points = [(row["step"] / 1e6, row[key]) for row in curve if key in row]
            named = label if axis is right else None
            axis.plot(*zip(*points, strict=True), style, color=color, alpha=alpha, markersize=4, label=named)
    left.set(xlabel="samples, millions", ylabel="distance per episode, m", title="acting by its mean; faint: exploring")
    right.set(xlabel="samples, millions", ylabel="episode length, control steps", title="exploring")
    for axis in (left, right):
        axis.grid(alpha=0.3)
    right.legend(fontsize=8)
    figure.savefig(CURVES, dpi=110)


def _longest(found: dict[str, Path]) -> dict[str, Path]:
    """Without the runs of which another is the continuation."""
    return {name: path for name, path in found.items() if not any(other.startswith(f"{name}-") for other in found)}


def text() -> str:
    """The document."""
    sections = (taught, teachers.section, averaging.section, learning, comparison, robots, whole_body)
    sections += (high_level_section.high_level, simcheck, needles.section, speed, ratios)
    return "\n".join([INTRO, *(part for part in (section() for section in sections) if part)])


def main() -> None:
    """Writes the document and its figures."""
    curves()
    high_level_section.curves(ROOT / "docs")
    (ROOT / "docs" / "results.md").write_text(text())


if __name__ == "__main__":
    main()
