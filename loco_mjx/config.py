"""The whole configuration as one tree of frozen dataclasses; the defaults are the paper's.

Every key is read somewhere, every key appears in the ``config.json`` a run writes before its first step.
Section numbers refer to the LocoTransformer paper's appendix where a default comes from there.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

from loco_mjx import a1
from loco_mjx.errors import UnknownNameError, UserError


@dataclass(frozen=True)
class ActionConfig:
    """How a policy's output becomes joint targets: default pose + scale · tanh(a)."""

    scale: tuple[float, float, float] = (0.5, 0.5, 0.5)  # rad, for hip, thigh, calf
    diagonal: bool = False  # 6-D: (FR, RL) share three, (FL, RR) share three

    @property
    def size(self) -> int:
        """Dimension of the policy's action."""
        return 6 if self.diagonal else 12


@dataclass(frozen=True)
class DepthConfig:
    """The depth camera: planar depth along the optical axis."""

    enabled: bool = True  # False renders nothing and leaves `pixels/depth` out of the observation
    height: int = 64
    width: int = 64
    vertical_fov: float = 60.0  # degrees
    horizontal_fov: float = 85.46  # degrees
    near: float = 0.3  # m, clip
    far: float = 10.0  # m, clip; misses read this
    frames: int = 4  # stacked, newest first
    blind_min: int = 3  # blind pixels per frame when noise is on: U{blind_min..blind_max}
    blind_max: int = 30
    noise: bool | None = None  # blind pixels; None follows randomization.enabled


@dataclass(frozen=True)
class ObservationConfig:
    """The parts of the observation."""

    state_frames: int = 3  # proprioceptive frames, newest first
    displacement: bool = True  # base displacement over the last control step (off: the real robot's 84-D state)
    goal: bool = False  # goal relative to the base, appended to `state`
    privileged: bool = False  # `privileged`: what only a simulator knows (loco_mjx/env/privileged.py)
    depth: DepthConfig = field(default_factory=DepthConfig)

    @property
    def state_size(self) -> int:
        """Length of the `state` vector."""
        per_frame = 12 + 4 + 12 + (3 if self.displacement else 0)
        return self.state_frames * per_frame + (3 if self.goal else 0)


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward's terms; see loco_mjx/env/reward.py."""

    forward: float = 1.0
    energy: float = 0.005 * a1.PHYSICS_DT  # times −‖τ‖²; the paper prints 0.005, which drowns every other term
    alive: float = 0.1
    sphere: float = 100.0  # per sphere collected
    vertical_speed: float = 0.0  # times −v_z²
    collision: float = 0.0  # times −1 in a control step with obstacle contact
    action_rate: float = 0.0  # times −‖u_t − u_{t−1}‖²
    target_speed: float | None = 1.0  # m/s, cap on the forward speed; None: no cap


@dataclass(frozen=True)
class TerminationConfig:
    """When an episode ends before its horizon."""

    min_up: float = 0.6  # z of the trunk's up axis
    min_height: float = 0.15  # m, base above the ground beneath it
    on_collision: bool = False


@dataclass(frozen=True)
class PhysicsConfig:
    """The MJX solver and the contact slots."""

    iterations: int = 2  # Newton iterations per physics step
    ls_iterations: int = 8  # line-search iterations per Newton iteration
    more_iterations: int = 4  # further ones of those environments that have not converged
    near_boxes: int = 16  # boxes nearest the robot's spheres that may touch it within one control step
    near_cylinders: int = 4  # likewise
    friction: float = 1.0  # lateral, of the feet and knees against everything


@dataclass(frozen=True)
class RandomizationConfig:
    """Domain randomisation, drawn at each reset and constant in the episode (paper, appendix A)."""

    enabled: bool = False
    kp: tuple[float, float] = (40.0, 90.0)
    kd: tuple[float, float] = (0.4, 0.8)
    inertia: tuple[float, float] = (0.5, 1.5)  # factor
    friction: tuple[float, float] = (0.5, 1.25)  # lateral coefficient
    mass: tuple[float, float] = (0.8, 1.2)  # factor
    motor_friction: tuple[float, float] = (0.0, 0.05)  # N·m·s/rad
    motor_strength: tuple[float, float] = (0.8, 1.2)  # factor, per motor
    latency: tuple[float, float] = (0.0, 0.04)  # s, IMU and joint angles


@dataclass(frozen=True)
class EnvConfig:
    """One task's environment."""

    task: str = "thin"
    horizon: int = 1000  # control steps
    kp: float = a1.KP
    kd: float = a1.KD
    start_range: float = 1.0  # m, start at ± this in x and y
    action: ActionConfig = field(default_factory=ActionConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    termination: TerminationConfig = field(default_factory=TerminationConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the policy networks (paper, appendix B)."""

    token_dim: int = 128
    tokens_per_side: Literal[1, 2, 4] = 4  # N: the visual features become N × N tokens
    layers: int = 2  # transformer encoder layers
    mlp_dim: int = 256  # of an encoder layer
    hidden: tuple[int, ...] = (256, 256)
    state_only_hidden: tuple[int, ...] = (256, 256, 256, 256)
    initial_std: float = 1.0
    latent_dim: int = 4  # hrl: width of the high level's command
    hold: int = 4  # hrl: control steps for which a command is held; divides ppo.unroll
    critic: Literal["shared", "privileged"] = "shared"  # privileged: an MLP on `state` and `privileged` is the value


@dataclass(frozen=True)
class PPOConfig:
    """PPO's hyper-parameters; the defaults are the paper's."""

    num_envs: int = 256
    unroll: int = 32  # control steps per environment and iteration
    minibatch: int = 256  # samples
    epochs: int = 3
    clip: float = 0.2
    discount: float = 0.99
    gae_lambda: float = 0.95
    learning_rate: float = 1e-4
    learning_rate_decay: bool = True  # linearly to zero over total_steps
    max_grad_norm: float = 0.5
    entropy: float = 0.005
    value_loss: float = 0.5
    optimizer: Literal["joint", "separate"] = "joint"  # separate: policy and value have their own clip and Adam
    reward_scale: float = 1.0  # of the rewards learnt from; those reported are not scaled
    total_steps: int = 15_000_000  # samples
    pool_size: int = 512  # scenes held ready for resets
    pool_refresh: int = 32  # iterations between new pools

    @property
    def samples_per_iteration(self) -> int:
        """Samples collected, and learnt from, in one iteration."""
        return self.num_envs * self.unroll

    @property
    def iterations(self) -> int:
        """Iterations that make up total_steps, rounded up."""
        return -(-self.total_steps // self.samples_per_iteration)


@dataclass(frozen=True)
class DistillConfig:
    """Method `distill`: a privileged teacher learns by PPO; the policy imitates it (DAgger), and may go on by PPO."""

    teacher_ratio: float = 4.0  # samples of the teacher for each of the policy
    imitation: float = 1.0  # share of the policy's samples in which it imitates; PPO in the rest
    std: float = 0.3  # of the policy's exploration while it imitates, and where PPO begins
    learning_rate: float = 1e-3  # while it imitates
    minibatch: int = 512
    epochs: int = 2


@dataclass(frozen=True)
class Config:
    """Everything that defines a run, apart from where it is written."""

    policy: str = "loco-transformer"
    method: Literal["ppo", "distill"] = "ppo"
    seed: int = 0
    distill: DistillConfig = field(default_factory=DistillConfig)
    env: EnvConfig = field(default_factory=EnvConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)


def _fast(config: Config) -> Config:
    """Tuned for wall-clock: fewer passes, larger steps, calmer hips, values of order 1 beside the policy's gradient."""
    action = dataclasses.replace(config.env.action, scale=(0.2, 0.5, 0.5))
    ppo = dataclasses.replace(
        config.ppo,
        minibatch=512,
        epochs=2,
        learning_rate=4e-4,
        entropy=1e-3,
        reward_scale=0.1,
        learning_rate_decay=False,
    )
    return dataclasses.replace(config, env=dataclasses.replace(config.env, action=action), ppo=ppo)


def _real(config: Config) -> Config:
    """`fast` for the real robot: what it cannot measure is not observed, and what is not known of it is drawn."""
    config = _fast(config)
    observation = config.env.observation
    env = dataclasses.replace(
        config.env,
        observation=dataclasses.replace(
            observation, displacement=False, depth=dataclasses.replace(observation.depth, noise=True)
        ),
        randomization=dataclasses.replace(config.env.randomization, enabled=True),
    )
    return dataclasses.replace(config, env=env)


def _paper(config: Config) -> Config:
    """The paper's, with the optimisers of the authors' code."""
    return dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, optimizer="separate", value_loss=1.0))


PRESETS = {"paper": _paper, "fast": _fast, "real": _real}


def preset(name: str) -> Config:
    """The configuration of a preset.

    Raises:
        UnknownNameError: if there is no preset of that name.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name](Config())


def check(config: Config, num_devices: int = 1) -> None:
    """Checks that sizes fit together.

    Raises:
        UserError: naming the sizes that do not divide, and what would.
    """
    ppo = config.ppo
    for name in ("num_envs", "unroll", "minibatch", "epochs", "total_steps", "pool_size", "pool_refresh"):
        if getattr(ppo, name) < 1:
            raise UserError(f"ppo.{name} is {getattr(ppo, name)}; accepted: 1 or more")
    if ppo.num_envs % num_devices:
        raise UserError(f"ppo.num_envs {ppo.num_envs} does not divide over {num_devices} devices; accepted: a multiple")
    if ppo.minibatch % num_devices:
        raise UserError(
            f"ppo.minibatch {ppo.minibatch} does not divide over {num_devices} devices; accepted: a multiple"
        )
    if ppo.samples_per_iteration % ppo.minibatch:
        raise UserError(
            f"ppo.minibatch {ppo.minibatch} does not divide the {ppo.samples_per_iteration} samples of an iteration "
            f"(num_envs {ppo.num_envs} × unroll {ppo.unroll}); accepted: a divisor of it"
        )
    _check_ranges(config)
    if config.method == "distill":
        _check_distill(config, num_devices)
    if config.network.tokens_per_side not in (1, 2, 4):
        raise UserError(f"network.tokens_per_side is {config.network.tokens_per_side}; accepted: 1, 2, 4")


def _check_distill(config: Config, num_devices: int) -> None:
    """Checks the values of method `distill`."""
    distill, samples = config.distill, config.ppo.samples_per_iteration
    if not 0 <= distill.imitation <= 1:
        raise UserError(f"distill.imitation is {distill.imitation}; accepted: 0 to 1")
    for name in ("teacher_ratio", "std", "learning_rate", "minibatch", "epochs"):
        if getattr(distill, name) <= 0:
            raise UserError(f"distill.{name} is {getattr(distill, name)}; accepted: more than 0")
    if samples % distill.minibatch or distill.minibatch % num_devices:
        raise UserError(
            f"distill.minibatch {distill.minibatch} does not divide the {samples} samples of an iteration, or not over "
            f"{num_devices} devices; accepted: a divisor of the one and a multiple of the other"
        )


def teacher_of(config: Config) -> Config:
    """The configuration of the teacher's run, for a run of method `distill`."""
    depth = dataclasses.replace(config.env.observation.depth, enabled=False)
    env = dataclasses.replace(config.env, observation=dataclasses.replace(config.env.observation, depth=depth))
    total = round(config.distill.teacher_ratio * config.ppo.total_steps)
    network = dataclasses.replace(config.network, critic="shared", initial_std=NetworkConfig.initial_std)
    ppo = dataclasses.replace(config.ppo, total_steps=total, optimizer="joint")
    return Config(policy="privileged", seed=config.seed, env=env, network=network, ppo=ppo)


def with_method(config: Config) -> Config:
    """The configuration with what its method and its policy need of the observation, the networks and the optimiser."""
    if config.method == "distill":
        network = dataclasses.replace(config.network, critic="privileged", initial_std=config.distill.std)
        ppo = dataclasses.replace(config.ppo, optimizer="separate")
        config = dataclasses.replace(config, network=network, ppo=ppo)
    if config.policy == "privileged" or config.network.critic == "privileged":
        observation = dataclasses.replace(config.env.observation, privileged=True)
        config = dataclasses.replace(config, env=dataclasses.replace(config.env, observation=observation))
    return config


def _check_ranges(config: Config) -> None:
    """Checks single values of the environment and the learner."""
    if config.env.horizon < 1:
        raise UserError(f"env.horizon is {config.env.horizon}; accepted: 1 or more control steps")
    if config.ppo.learning_rate <= 0:
        raise UserError(f"ppo.learning_rate is {config.ppo.learning_rate}; accepted: more than 0")
    for name in ("discount", "gae_lambda"):
        if not 0 <= getattr(config.ppo, name) <= 1:
            raise UserError(f"ppo.{name} is {getattr(config.ppo, name)}; accepted: 0 to 1")
    for name, value in dataclasses.asdict(config.env.randomization).items():
        if isinstance(value, tuple) and not 0 <= value[0] <= value[1]:
            raise UserError(
                f"env.randomization.{name} is {value}; accepted: two values, the lower first, neither negative"
            )
    depth = config.env.observation.depth
    if not 0 < depth.near < depth.far:
        raise UserError(f"env.observation.depth: near {depth.near}, far {depth.far}; accepted: 0 < near < far")
    if not 0 <= depth.blind_min <= depth.blind_max:
        raise UserError(
            f"env.observation.depth: blind_min {depth.blind_min}, blind_max {depth.blind_max} are not in order"
        )


def to_dict(config: Any) -> dict[str, Any]:
    """A configuration as plain JSON types."""
    return dataclasses.asdict(config)


def from_dict(kind: type, values: dict[str, Any]) -> Any:
    """Rebuilds a configuration from :func:`to_dict`'s output.

    A missing key, one that a later version brought, takes its default: a new key's default is what was done before.

    Raises:
        UserError: on a key that the configuration does not have.
    """
    import typing

    hints = typing.get_type_hints(kind)
    names = {f.name for f in dataclasses.fields(kind)}
    if not names >= set(values):
        raise UserError(f"{kind.__name__} has no keys {sorted(set(values) - names)} in this version")
    built = {}
    for name, value in values.items():
        hint = hints[name]
        if dataclasses.is_dataclass(hint):
            value = from_dict(hint, value)  # type: ignore[arg-type]
        elif isinstance(value, list):
            value = tuple(value)
        built[name] = value
    return kind(**built)
