"""How each kind of fault is put into a robot that runs on C MuJoCo, from tests.deploy.faulty.FAULT on."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np

from loco_mjx.deploy.estop import EmergencyStop
from loco_mjx.deploy.safety import Cause
from tests.deploy import flat
from tests.deploy.faulty import FAULT, Clock, Faulty

ONE = np.eye(12)[2]  # a calf
TILTED = np.array([np.cos(0.6), np.sin(0.6), 0.0, 0.0])
PUSH = 0.5  # s
LONG = 20.0  # s: longer than anything waits for


@dataclass(frozen=True)
class Case:
    """A robot with a fault to come.

    Attributes:
        causes: any of which the runner may tell.
        robot: the robot.
        runner: arguments of the runner.
    """

    causes: tuple[Cause, ...]
    robot: Faulty
    runner: dict[str, Any] = field(default_factory=dict)


Fault = Callable[[], Case]


def measured(cause: Cause, change: Callable[[Any], Any], **runner: Any) -> Fault:
    """Measurements are changed."""
    return lambda: Case((cause,), Faulty(sensors=change), runner)


def seen(cause: Cause, change: Callable[[Any], Any], **runner: Any) -> Fault:
    """Images are changed."""
    return lambda: Case((cause,), Faulty(frame=change), runner)


def changed(**values: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Replaces parts of a measurement or an image by what functions make of them."""
    return lambda old: replace(old, **{name: change(getattr(old, name)) for name, change in values.items()})


def stopped_changing(*names: str) -> Callable[[Any], Any]:
    """Parts of a measurement or an image stay as they are when the fault comes; their time goes on."""
    kept: dict[int, Any] = {}

    def freeze(old: Any) -> Any:
        return replace(old, **{name: getattr(kept.setdefault(0, old), name) for name in names})

    return freeze


def frozen(cause: Cause, part: str, *names: str, **runner: Any) -> Fault:
    """Parts of measurements (`sensors`) or images (`frame`) stand still."""
    return lambda: Case((cause,), Faulty(**{part: stopped_changing(*names)}), runner)


def raising(error: Exception) -> Callable[..., Any]:
    """A function that raises, whatever it is given."""

    def fail(*_: Any) -> Any:
        raise error

    return fail


def stuck_joint() -> Case:
    """One encoder gives the same angle and speed while the leg goes on moving."""
    freeze = stopped_changing("angles", "velocities")

    def stick(old: Any) -> Any:
        kept = freeze(old)
        pick = ONE > 0
        return replace(
            old,
            angles=np.where(pick, kept.angles, old.angles),
            velocities=np.where(pick, kept.velocities, old.velocities),
        )

    ticks = count()

    def sway(obs: Any) -> np.ndarray:
        return flat.still(obs) + 0.15 * math.sin(0.7 * next(ticks)) * np.tile([0.0, 1.0, -1.0], 4)

    return Case((Cause.STALE_SENSORS,), Faulty(sensors=stick), {"policy": sway})


def clock(change: Callable[[float], float], **robot: Any) -> Fault:
    """The robot's clock is changed."""
    return lambda: Case((Cause.CLOCK,), Clock(change, **robot))


def policy(causes: tuple[Cause, ...], act: Callable[[Any], Any], **runner: Any) -> Fault:
    """From the fault on, another policy."""

    def case() -> Case:
        robot = Faulty()
        return Case(causes, robot, {"policy": lambda obs: (act if robot.broken else flat.still)(obs)} | runner)

    return case


def late() -> Case:
    """Every tick takes longer than it may, but none very long."""
    robot, ticks = Faulty(), count()
    return Case((Cause.DEADLINE,), robot, {"clock": lambda: 0.05 * next(ticks) if robot.broken else 0.0})


def command(causes: tuple[Cause, ...], error: Exception, fails: Callable[[int], bool], **robot: Any) -> Fault:
    """Commands raise, by their number from the fault on."""

    def case() -> Case:
        numbers = count()

        def before(robot: Faulty) -> None:
            if fails(next(numbers)):
                raise error

        return Case(causes, Faulty(before=before, **robot))

    return case


def at_fault(cause: Cause, act: Callable[[Faulty], None], **runner: Any) -> Fault:
    """Something happens once."""

    def case() -> Case:
        done: list[int] = []
        return Case((cause,), Faulty(before=lambda robot: done or (done.append(1), act(robot))), runner)

    return case


def pressed() -> Case:
    """Somebody presses the emergency stop in another thread."""
    estop = EmergencyStop()
    press = threading.Thread(target=estop.press, args=("somebody",))
    return replace(at_fault(Cause.ESTOP, lambda robot: press.start())(), runner={"estop": estop})


def fallen(**runner: Any) -> Fault:
    """A robot that seems to have fallen."""
    return measured(Cause.TILT, changed(quat=lambda quat: TILTED), **runner)


def push(robot: Faulty) -> None:
    """Tips the trunk over, for a moment."""
    robot.data.xfrc_applied[1, 3] = 40.0 if robot.now() < FAULT + PUSH else 0.0  # N·m about x


def flail(obs: Any) -> np.ndarray:
    """Targets that no joint can reach."""
    return np.where(np.arange(12) % 2, 1e9, -1e9)
