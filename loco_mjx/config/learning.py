"""What concerns learning: the networks' sizes, PPO's hyper-parameters, and those of method `distill`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from loco_mjx.config.quantities import (
    Deviation,
    LearningRate,
    NumEnvs,
    Passes,
    Samples,
    Share,
    TotalSteps,
    Weight,
    Width,
)
from loco_mjx.ranges import Range


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the policy networks (paper, appendix B)."""

    token_dim: Width = 128
    tokens_per_side: Literal[1, 2, 4] = 4  # N: the visual features become N × N tokens
    layers: Annotated[int, Range(0, 100)] = 2  # transformer encoder layers
    mlp_dim: Width = 256  # of an encoder layer
    hidden: tuple[Width, ...] = (256, 256)
    state_only_hidden: tuple[Width, ...] = (256, 256, 256, 256)
    initial_std: Deviation = 1.0
    latent_dim: Width = 4  # hrl: width of the high level's command
    hold: Passes = 4  # hrl: control steps for which a command is held; divides ppo.unroll
    critic: Literal["shared", "privileged"] = "shared"  # privileged: an MLP on `state` and `privileged` is the value


@dataclass(frozen=True)
class PPOConfig:
    """PPO's hyper-parameters; the defaults are the paper's."""

    num_envs: NumEnvs = 256
    unroll: Annotated[int, Range(1, 2**16)] = 32  # control steps per environment and iteration
    minibatch: Samples = 256  # samples
    epochs: Passes = 3
    clip: Deviation = 0.2
    discount: Share = 0.99
    gae_lambda: Share = 0.95
    learning_rate: LearningRate = 1e-4
    learning_rate_decay: bool = True  # linearly to zero over total_steps
    max_grad_norm: Annotated[float, Range(0, 1e6, above=True)] = 0.5
    entropy: Weight = 0.005
    final_std: Deviation | None = None  # exploration's std stays below a limit that falls to this; None: no limit
    # The policy is the mean of its parameters over iterations: what the mean of before weighs, the rest is the new ones
    # (0.95: those of about 20 iterations count); 0: the last ones.
    average: Share = 0.0
    value_loss: Annotated[float, Range(0, 10_000)] = 0.5
    optimizer: Literal["joint", "separate"] = "joint"  # separate: policy and value have their own clip and Adam
    reward_scale: Annotated[float, Range(0, 10_000, above=True)] = (
        1.0  # of the rewards learnt from; those reported are not scaled
    )
    total_steps: TotalSteps = 15_000_000  # samples
    pool_size: Annotated[int, Range(1, 2**20)] = 512  # scenes held ready for resets
    pool_refresh: Annotated[int, Range(1, 2**30)] = 32  # iterations between new pools

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

    teacher_ratio: Annotated[float, Range(0, 1000, above=True)] = 4.0  # samples of the teacher for each of the policy
    teacher_std: Deviation | None = None  # its `ppo.final_std`, if any; its learning rate then falls to 0 with it
    teacher_collision: Weight = 0.0  # its reward has this much more of `env.reward.collision`
    imitation: Share = 1.0  # share of the policy's samples in which it imitates; PPO in the rest
    std: Deviation = 0.3  # of the policy's exploration while it imitates, and where PPO begins
    learning_rate: LearningRate = 1e-3  # while it imitates
    learning_rate_decay: bool = False  # falls linearly to 0 over the imitation
    minibatch: Samples = 512
    epochs: Passes = 2
