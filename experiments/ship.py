"""Puts a trained policy into the package: ``python -m experiments.ship RUN NAME``.

RUN is the directory of a run that has been evaluated; NAME is what users call the policy by. The policy goes into
``loco_mjx/policies/NAME``, without what acting does not need, with the figures of the run's newest evaluation.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from loco_mjx import policies


def main() -> None:
    """Ships what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="directory of a run")
    parser.add_argument("name", help="e.g. mountain")
    options = parser.parse_args()
    from loco_mjx.deploy import export, trained

    policy, evaluation = trained.load(options.run), export.latest_evaluation(options.run)
    if evaluation is None:
        parser.error(f"{options.run} has not been evaluated; loco-mjx evaluate {options.run} does that")
    target = policies.SHIPPED / options.name
    shutil.rmtree(target, ignore_errors=True)
    export.write(policy, target, evaluation, lean=True)
    print(f"{target}: {sum(file.stat().st_size for file in target.iterdir()) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
