"""How fast is it? Runs the benchmarks and keeps their JSON: ``python -m experiments.speed``."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

RESULTS = Path(__file__).parent / "results" / "cpu" / "bench"
BENCHES = (
    ("depth", "thin", None, None),
    ("depth", "mountain", None, None),
    ("physics", "thin", None, None),
    ("physics", "mountain", None, None),
    ("env", "thin", None, None),
    ("env", "mountain", None, None),
    ("train", "thin", "loco-transformer", None),
    ("train", "thin", "state-only", None),
    ("train", "mountain", "loco-transformer", None),
    ("train", "thin", "state-only", 5),
)


def main() -> None:
    """Runs the benchmarks that the command line names, e.g. depth-thin, or all; one after the other."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    for kind, task, policy, seeds in BENCHES:
        name = "-".join(filter(None, (kind, task, policy, seeds and f"{seeds}-seeds")))
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        command = ["bench", kind, "--task", task, *(["--policy", policy] if policy else [])]
        command += [*(["--seeds", str(seeds)] if seeds else []), "--json"]
        done = subprocess.run(
            [sys.executable, "-m", "loco_mjx.cli.main", *command], check=True, capture_output=True, text=True
        )
        result = {"command": " ".join(["loco-mjx", *command])} | json.loads(done.stdout)
        (RESULTS / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")
        print(name, round(result["per_second"]), flush=True)


if __name__ == "__main__":
    main()
