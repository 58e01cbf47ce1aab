"""The whole configuration as one tree of frozen dataclasses; the defaults are the paper's.

Every key is read somewhere, every key appears in the ``config.json`` a run writes before its first step.
Section numbers refer to the LocoTransformer paper's appendix where a default comes from there. Every number has a
declared range (loco_mjx/ranges.py): wide enough for any experiment, narrow enough that nothing overflows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

import tyro

from loco_mjx import controllers, sensors
from loco_mjx.config.learning import DistillConfig, NetworkConfig, PPOConfig
from loco_mjx.config.quantities import (
    Angle,
    Blind,
    Degrees,
    Factor,
    Frames,
    Kd,
    Kp,
    Latency,
    Mass,
    Metres,
    Passes,
    Pixels,
    Weight,
)
from loco_mjx.config.reward_terms import Weights, default_weights
from loco_mjx.ranges import SEED, Each, Range
from loco_mjx.robots import DEFAULT, NJOINT


@dataclass(frozen=True)
class ActionConfig:
    """How a policy's output becomes joint targets: default pose + scale · tanh(a)."""

    scale: tuple[Angle, Angle, Angle] = (0.5, 0.5, 0.5)  # rad, for hip, thigh, calf
    diagonal: bool = False  # 6-D: (FR, RL) share three, (FL, RR) share three

    @property
    def size(self) -> int:
        """Dimension of the policy's action."""
        return NJOINT // 2 if self.diagonal else NJOINT


@dataclass(frozen=True)
class DepthConfig:
    """The depth camera: planar depth along the optical axis."""

    enabled: bool = True  # False renders nothing and leaves `pixels/depth` out of the observation
    height: Pixels = 64
    width: Pixels = 64
    vertical_fov: Degrees = 60.0  # degrees
    horizontal_fov: Degrees = 85.46  # degrees
    near: Metres = 0.3  # m, clip
    far: Metres = 10.0  # m, clip; misses read this
    frames: Frames = 4  # stacked, newest first
    blind_min: Blind = 3  # blind pixels per frame when noise is on: U{blind_min..blind_max}
    blind_max: Blind = 30
    noise: bool | None = None  # blind pixels; None follows randomization.enabled


@dataclass(frozen=True)
class ObservationConfig:
    """The parts of the observation."""

    state_frames: Frames = 3  # proprioceptive frames, newest first
    displacement: bool = True  # base displacement over the last control step (off: the real robot's 84-D state)
    velocity: bool = False  # of the trunk; this and the next are the whole-body controller's policies'
    attitude: bool = False  # roll, pitch, yaw
    imu: bool = True  # roll, pitch and their rates
    last_action: bool = True  # joint targets
    angles: bool = True  # of the joints
    goal: bool = False  # goal relative to the base, appended to `state`
    privileged: bool = False  # `privileged`: what only a simulator knows (loco_mjx/env/privileged.py)
    depth: DepthConfig = field(default_factory=DepthConfig)

    @property
    def state_size(self) -> int:
        """Length of the `state` vector."""
        per_frame = sum(sensor.size for sensor in sensors.in_use(self).values())
        return self.state_frames * per_frame + (3 if self.goal else 0)


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward's terms; see loco_mjx/env/reward.py.

    The terms that were registered from outside are in `terms`; written down, and on the command line, they stand beside
    the others: `--env.reward.my-term 0.5`.
    """

    forward: Weight = 1.0
    energy: Weight = 0.005 * 0.0025  # times −‖τ‖²; the paper prints 0.005, which drowns every other term
    alive: Weight = 0.1
    sphere: Weight = 100.0  # per sphere collected
    vertical_speed: Weight = 0.0  # times −v_z²
    collision: Weight = 0.0  # times −1 in a control step with obstacle contact
    action_rate: Weight = 0.0  # times −‖u_t − u_{t−1}‖²
    target_speed: Annotated[float, Range(0, 100, above=True)] | None = (
        1.0  # m/s, cap on the forward speed; None: no cap
    )
    # By name, of the terms that were registered; one of weight 0 is not computed.
    terms: Annotated[Weights, Each(Weight), tyro.conf.arg(name="")] = field(default_factory=default_weights)

    def __post_init__(self) -> None:
        """Takes any mapping for `terms`."""
        if isinstance(self.terms, Mapping):  # what it is else is said where all values are checked
            object.__setattr__(self, "terms", Weights(self.terms))


@dataclass(frozen=True)
class TerminationConfig:
    """When an episode ends before its horizon."""

    min_up: Annotated[float, Range(-1, 1)] = 0.6  # z of the trunk's up axis
    min_height: Annotated[float, Range(-1, 1)] = 0.15  # m, base above the ground beneath it
    on_collision: bool = False


@dataclass(frozen=True)
class PhysicsConfig:
    """Rigid-body dynamics, the solver of the constraints, and the contact slots."""

    dynamics: Literal["closed-form", "mjx"] = "closed-form"  # whose mass matrix and bias forces; equal to rounding
    iterations: Passes = 2  # Newton iterations per physics step
    ls_iterations: Passes = 8  # line-search iterations per Newton iteration
    more_iterations: Annotated[int, Range(0, 1000)] = 4  # further ones of those environments that have not converged
    near_boxes: Annotated[int, Range(0, 1000)] = (
        16  # boxes nearest the robot's spheres that may touch it within one control step
    )
    near_cylinders: Annotated[int, Range(0, 1000)] = 4  # likewise
    friction: Factor = 1.0  # lateral, of the feet and knees against everything


@dataclass(frozen=True)
class RandomizationConfig:
    """Domain randomisation, drawn at each reset and constant in the episode (paper, appendix A)."""

    enabled: bool = False
    kp: tuple[Kp, Kp] = (40.0, 90.0)
    kd: tuple[Kd, Kd] = (0.4, 0.8)
    inertia: tuple[Mass, Mass] = (0.5, 1.5)  # factor
    friction: tuple[Factor, Factor] = (0.5, 1.25)  # lateral coefficient
    mass: tuple[Mass, Mass] = (0.8, 1.2)  # factor
    motor_friction: tuple[Factor, Factor] = (0.0, 0.05)  # N·m·s/rad
    motor_strength: tuple[Factor, Factor] = (0.8, 1.2)  # factor, per motor
    latency: tuple[Latency, Latency] = (0.0, 0.04)  # s, IMU and joint angles


@dataclass(frozen=True)
class EnvConfig:
    """One task's environment, for one robot."""

    task: str = "thin"
    robot: str = DEFAULT  # by name, or the path of its MJCF
    controller: Literal["pd", "mpc"] = "pd"  # loco_mjx/controllers.py; what else it changes, by `with_controller`
    horizon: Annotated[int, Range(1, 1_000_000)] = 1000  # control steps
    kp: Kp = 40.0  # N·m/rad; this, kd and action.scale are the A1's, others' by `with_robot`
    kd: Kd = 0.6  # N·m·s/rad
    start_range: Annotated[float, Range(0, 100)] = 1.0  # m, start at ± this in x and y
    action: ActionConfig = field(default_factory=ActionConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    termination: TerminationConfig = field(default_factory=TerminationConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)

    @property
    def action_size(self) -> int:
        """Dimension of the policy's action."""
        controller = controllers.get_controller(self.controller)
        return self.action.size if controller.scale is None else controller.size


@dataclass(frozen=True)
class Config:
    """Everything that defines a run, apart from where it is written."""

    policy: str = "loco-transformer"
    method: Literal["ppo", "distill"] = "ppo"
    seed: SEED = 0
    distill: DistillConfig = field(default_factory=DistillConfig)
    env: EnvConfig = field(default_factory=EnvConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    imports: tuple[str, ...] = ()  # the user's modules that bring its task, policy or terms of the reward
