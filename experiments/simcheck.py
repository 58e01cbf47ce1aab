"""Is C MuJoCo's walk ours? Exports trained policies and compares: ``python -m experiments.simcheck NAME ...``.

NAME is a run of ``experiments.learning`` or, with ``--runs runs/taught``, of ``experiments.taught``; results go to
``experiments/results/cpu/simcheck/``. Our side's physics is what users get, whatever the run was trained with.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from loco_mjx.config import PhysicsConfig

RESULTS = Path(__file__).parent / "results" / "cpu" / "simcheck"


def main() -> None:
    """Compares the policies that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+", help="runs, e.g. thin-state-only-seed0")
    parser.add_argument("--runs", type=Path, default=Path("runs/learning"), help="where the run directories are")
    parser.add_argument("--episodes", type=int, default=64, help="of each")
    parser.add_argument("--prisms", action="store_true", help="leave C's own contacts with a heightfield")
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-m", "loco_mjx.cli.main"]
    for name in options.names:
        with tempfile.TemporaryDirectory() as folder:
            policy = str(Path(folder) / "policy")
            subprocess.run([*program, "export", str(options.runs / name), "--out", policy], check=True)
            solver = [str(PhysicsConfig().iterations), str(PhysicsConfig().ls_iterations)]
            command = [*program, "simcheck", policy, "--episodes", str(options.episodes), "--solver", *solver, "--json"]
            command += ["--prisms"] if options.prisms else []
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        written = RESULTS / f"{name}{'-prisms' if options.prisms else ''}.json"
        written.write_text(json.dumps(json.loads(done.stdout), indent=1) + "\n")


if __name__ == "__main__":
    main()
