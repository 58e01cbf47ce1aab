"""`loco-mjx export`: writes a run's policy as a folder that explains itself and runs without JAX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from loco_mjx import policies
from loco_mjx.cli.options import Step
from loco_mjx.cli.parse import parse

PROG = "loco-mjx export"


@dataclass(frozen=True)
class Options:
    """Writes the policy of a run: ONNX, its description, raw parameters, and StableHLO."""

    directory: tyro.conf.Positional[Path]
    """The run's directory, a policy's folder, or the name of a shipped policy."""
    out: Path = Path("policy")
    """Folder to write; made if it does not exist."""
    step: Step = None
    """Which checkpoint of the run: the samples trained at it, or best by evaluation; None: the newest."""


def main(args: Sequence[str]) -> int:
    """Runs the command.

    Raises:
        UserError: if there is no usable run, or nowhere to write; nothing is written then.
    """
    options = parse(Options, args, PROG)
    from loco_mjx.run import machine

    machine.set_up()
    from loco_mjx.deploy import export

    manifest = export.export(policies.find(options.directory), options.out, options.step)
    training, inputs = manifest["training"], ", ".join(manifest["inputs"])
    print(f"wrote {options.out}: {manifest['policy']} trained on {training['task']} ({training['samples']:,} samples)")
    out = "; ".join(
        f"{about['shape'][0]} {about['meaning'].partition(' of ')[0]}, {about['unit']}"
        for about in manifest["outputs"].values()
    )
    print(f"in: {inputs}; out: {out}; next: loco-mjx deploy {options.out} --task {training['task']}")
    return 0
