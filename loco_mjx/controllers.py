"""What stands between a policy and the motors, as data: how many numbers a policy gives out, how often, what they mean.

`pd` holds joint targets. `mpc` is the whole-body controller (loco_mjx/whole_body/), which walks as it is commanded. The
environment drives the robot by them (loco_mjx/env/drive.py), deployment runs them without JAX. Needs no JAX itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from loco_mjx.errors import UnknownNameError
from loco_mjx.robots import NJOINT, Robot

DEFAULT = "pd"
TICK = 0.005  # s, of the whole-body controller: 200 Hz
SPEED_LIMIT = 0.4  # m/s, of its commands
YAW_RATE_LIMIT = 0.3  # rad/s, of its commands


@dataclass(frozen=True)
class Controller:
    """What a policy's output is.

    Attributes:
        name: of the controller.
        output: what its policies' output is called.
        size: numbers of it.
        unit: of it.
        meaning: in words, for who reads ``policy.json``.
        scale: (size,) what an action of 1 adds; None: the configuration's `env.action`, which is joints' alone.
        policy_hz: control steps per second; None: the robot's own.
    """

    name: str
    output: str
    size: int
    unit: str
    meaning: str
    scale: tuple[float, ...] | None = None
    policy_hz: int | None = None

    def rate(self, robot: Robot) -> int:
        """Control steps per second of a robot under it."""
        return self.policy_hz or robot.policy_hz


def ticks(policy_hz: float) -> int:
    """The whole-body controller's ticks in a control step."""
    return round(1 / (policy_hz * TICK))


CONTROLLERS = {
    one.name: one
    for one in (
        Controller("pd", "targets", NJOINT, "rad", "joint targets of the PD controller"),
        Controller(
            "mpc",
            "commands",
            2,
            "m/s, rad/s",
            "speed ahead and yaw rate, for the whole-body controller",
            (SPEED_LIMIT, YAW_RATE_LIMIT),
            20,
        ),
    )
}


def get_controller(name: str) -> Controller:
    """A controller by its name.

    Raises:
        UnknownNameError: if there is none of that name.
    """
    if name not in CONTROLLERS:
        raise UnknownNameError("controller", name, CONTROLLERS)
    return CONTROLLERS[name]
