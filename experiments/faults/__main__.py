"""Runs the campaign of faults: ``python -m experiments.faults``, or with ``--small`` a tenth of it.

``python -m experiments.faults robots memory`` runs these parts alone; the figures of the others stay as they are in
``experiments/results/faults.json`` and in docs/reliability.md. The former also has every case that went wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.faults import lines, memory, robots, told, training
from loco_mjx.run import machine, provenance

RESULT = Path(__file__).parents[1] / "results" / "faults.json"
# Each with how many faults it injects, or for how many iterations it goes on.
PARTS: dict[str, tuple[Callable[[Path, int, int], dict[str, Any]], int]] = {
    "corruptions": (training.corruptions, 500),
    "disks": (training.disks, 10),
    "kills": (training.kills, 200),
    "lines": (lines.lines, 1000),
    "robots": (robots.robots, len(robots.FAULTS)),
    "memory": (memory.memory, 1000),
}


def main() -> int:
    """Runs parts and writes their figures; 1 if anything was lost, hung, accepted or not told in one line."""
    parser = argparse.ArgumentParser(prog="python -m experiments.faults", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; none: all")
    parser.add_argument("--small", action="store_true", help="a tenth of it")
    for name, (_, count) in PARTS.items():
        parser.add_argument(f"--{name}", type=int, default=count, metavar="COUNT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    unknown = sorted(set(options.parts) - set(PARTS))
    if unknown:
        parser.error(f"unknown part '{unknown[0]}'; accepted: {', '.join(PARTS)}")
    machine.cores = lambda: 1  # as the processes that are killed have it
    machine.set_up(1)
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for name in options.parts or PARTS:
            count = getattr(options, name)
            found = PARTS[name][0](Path(folder), options.seed, max(1, count // 10) if options.small else count)
            keep(
                options.out,
                name,
                found | {"seed": options.seed, "about": provenance.describe(["experiments.faults", name])},
            )
            print(name, {key: value for key, value in found.items() if key != "problems"}, flush=True)
            print(*found["problems"], sep="\n", flush=True)
            failed |= bool(found["problems"])
    return int(failed)


def keep(path: Path, name: str, found: dict[str, Any]) -> None:
    """Writes one part's figures beside those of the others."""
    before = json.loads(path.read_text()) if path.exists() else {}
    figures = before | {name: found}
    path.write_text(json.dumps({part: figures[part] for part in PARTS if part in figures}, indent=1) + "\n")
    if path == RESULT:
        told.write(figures)


if __name__ == "__main__":
    sys.exit(main())
