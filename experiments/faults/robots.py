"""Faults of a robot, one by one, on C MuJoCo under the real runner: each has to end with the robot lying down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.faults.robot_cases import Case
from experiments.faults.robot_faults import FAULTS
from loco_mjx.robots import get_robot
from tests.deploy import flat
from tests.deploy.faulty import lies

SECONDS = 1.5  # to run the policy for; the fault comes after 0.4 of them
PATIENCE = 1.0  # s that a tick may take on a busy machine, as `loco-mjx deploy` has it for this robot
NUMBER = 1e-9  # rad, of rounding


def robots(folder: Path, seed: int, count: int) -> dict[str, Any]:
    """Injects faults, spread over the list where they are not to be all of them."""
    names = list(FAULTS)
    chosen = [names[int(i)] for i in np.linspace(0, len(names) - 1, min(count, len(names)))]
    found, problems = {}, []
    for name in chosen:
        case = FAULTS[name]()
        cause, wrong = injected(case)
        found[name] = cause
        if wrong:
            problems.append(f"{name}: {'; '.join(wrong)}")
    sit_downs = len(chosen) - len(problems)
    return {"injected": len(chosen), "sit_downs": sit_downs, "causes": found, "problems": problems}


def injected(case: Case) -> tuple[str | None, list[str]]:
    """Runs a robot that something goes wrong with: the cause that was told, and what was not as it should be."""
    runner = flat.runner(case.robot, **({"patience": PATIENCE} | case.runner))
    try:
        record = runner.run(SECONDS)
    except Exception as error:
        return None, [f"{type(error).__name__}: {error}"]
    wrong = (
        [] if record.cause in case.causes else [f"its cause is {record.cause}, not one of {[*map(str, case.causes)]}"]
    )
    if record.cause is not None and not any(text.startswith(record.cause) for _, text in record.events):
        wrong.append("its cause is not among the events")
    targets, body = np.array([targets for targets, _, _ in case.robot.commands]), get_robot("a1")
    within = (targets >= np.array(body.lower) - NUMBER) & (targets <= np.array(body.upper) + NUMBER)
    if not within.all():
        wrong.append(f"{int((~within.all(axis=1)).sum())} commands are beyond the joints' limits")
    if not lies(case.robot):
        wrong.append(f"the trunk is at {case.robot.data.qpos[2]:.2f} m in the end")
    return record.cause, wrong
