"""The whole-body controller's numbers. Where they are not the authors', docs/whole_body.md says why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from loco_mjx.ranges import Range


@dataclass(frozen=True)
class Gait:
    """A trot by the clock.

    Attributes:
        stance: s that a foot stays on the ground.
        duty: part of a cycle that a foot stays on the ground.
        phases: of the legs FR, FL, RR, RL at time 0, in cycles; see `swings_first`.
        swings_first: whether a leg's cycle begins with its swing.
        blind: part of a stance or swing in whose beginning contact, or the lack of it, is not looked at.
    """

    stance: Annotated[float, Range(0.05, 1)] = 0.25
    duty: Annotated[float, Range(0.3, 0.9)] = 0.6
    phases: tuple[float, float, float, float] = (0.9, 0.0, 0.0, 0.9)
    swings_first: tuple[bool, bool, bool, bool] = (True, False, False, True)
    blind: Annotated[float, Range(0, 1)] = 0.1

    @property
    def cycle(self) -> float:
        """Duration of a stance and a swing, s."""
        return self.stance / self.duty


@dataclass(frozen=True)
class Swing:
    """How a leg swings.

    Attributes:
        clearance: m that the foot is lifted above the higher end of its way.
        feedback: s, Raibert's gain on the speed's error.
        landing: m above the ground, as it was measured, at which a foot's way ends.
        kp: N·m/rad.
        kd: N·m·s/rad, of hip, thigh and calf.
    """

    clearance: Annotated[float, Range(0, 0.3)] = 0.1
    feedback: Annotated[float, Range(0, 1)] = 0.03
    landing: Annotated[float, Range(-0.1, 0.1)] = 0.01
    kp: Annotated[float, Range(0, 500)] = 100.0
    kd: tuple[float, float, float] = (1.0, 2.0, 2.0)


@dataclass(frozen=True)
class Mpc:
    """The quadratic program of the stance forces.

    Attributes:
        horizon: steps that are planned.
        dt: s of one.
        attitude: weights on roll, pitch, yaw.
        position: weights on x, y, height; only of the height a deviation is measured.
        spin: weights on the angular velocity.
        velocity: weights on the velocity.
        force: weight on a force's square.
        friction: coefficient that the forces are to stay within.
        least: vertical force of a standing foot, in units of the robot's weight.
        most: the same, at most.
        foresee: whether planned steps take the legs that the gait's clock lets stand then, not those that stand now.
    """

    horizon: Annotated[int, Range(1, 20)] = 10
    dt: Annotated[float, Range(0.005, 0.1)] = 0.025
    attitude: tuple[float, float, float] = (5.0, 5.0, 0.2)
    position: tuple[float, float, float] = (0.0, 0.0, 10.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 1.0)
    velocity: tuple[float, float, float] = (1.0, 1.0, 0.0)
    force: Annotated[float, Range(0, 1, above=True)] = 1e-5
    friction: Annotated[float, Range(0, 2, above=True)] = 0.45
    least: Annotated[float, Range(0, 1)] = 0.1
    most: Annotated[float, Range(1, 20)] = 10.0
    foresee: bool = True


@dataclass(frozen=True)
class WholeBodyConfig:
    """The whole-body controller.

    Attributes:
        gait: when legs swing.
        swing: how they do.
        mpc: how the others push.
        height: m, of the trunk above the feet's centres.
    """

    gait: Gait = field(default_factory=Gait)
    swing: Swing = field(default_factory=Swing)
    mpc: Mpc = field(default_factory=Mpc)
    height: Annotated[float, Range(0.1, 0.4)] = 0.24
