"""What has a change cost? Two commits, measured in turn: ``python -m experiments.ratio OLD NEW env:mountain ...``.

Every part, e.g. ``physics:indoor``, is measured by `loco-mjx bench` of both commits one after the other, several times;
the ratio is that of the best of each, which what else runs on the machine disturbs least. The figures of a comparison
go to ``experiments/results/cpu/ratio/``, named by ``--name``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "experiments" / "results" / "cpu" / "ratio"


def checked_out(commit: str, folder: Path) -> str:
    """Puts a commit's files into a folder; its full name."""
    git = ["git", "-C", str(ROOT)]
    full = subprocess.run([*git, "rev-parse", commit], check=True, capture_output=True, text=True).stdout.strip()
    archive = subprocess.run([*git, "archive", full], check=True, capture_output=True).stdout
    folder.mkdir()
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return full


def bench(folder: Path, kind: str, task: str, seconds: float) -> dict[str, Any]:
    """One measurement of one commit."""
    command = [sys.executable, "-m", "loco_mjx.cli.main", "bench", kind, "--task", task]
    inherited = os.environ | {"PYTHONPATH": str(folder)}
    command += ["--seconds", str(seconds), "--json"]
    done = subprocess.run(command, cwd=folder, env=inherited, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def compare(folders: dict[str, Path], kind: str, task: str, rounds: int, seconds: float) -> dict[str, Any]:
    """All measurements of a part, in turn, and the ratio of the best."""
    found: dict[str, list[dict[str, Any]]] = {which: [] for which in folders}
    for _ in range(rounds):
        for which, folder in folders.items():
            found[which].append(bench(folder, kind, task, seconds))
    speeds = {which: [one["per_second"] for one in measured] for which, measured in found.items()}
    last = found["new"][-1]
    about = {key: last[key] for key in ("bench", "task", "num_envs", "devices", "device_kind", "versions")}
    return about | {"per_second": speeds, "ratio": max(speeds["new"]) / max(speeds["old"])}


def main() -> None:
    """Measures what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", help="commit before the change")
    parser.add_argument("new", help="commit after it")
    parser.add_argument("parts", nargs="+", help="KIND:TASK, e.g. physics:indoor, env:mountain, depth:thin")
    parser.add_argument("--name", required=True, help="of the file with the figures")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        folders = {"old": Path(folder) / "old", "new": Path(folder) / "new"}
        commits = {which: checked_out(getattr(options, which), path) for which, path in folders.items()}
        results: dict[str, Any] = {"command": " ".join(["python -m experiments.ratio", *sys.argv[1:]]), **commits}
        for part in options.parts:
            results[part] = compare(folders, *part.split(":"), options.rounds, options.seconds)
            print(f"{part}: {results[part]['ratio']:.3f}", flush=True)
    (RESULTS / f"{options.name}.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
