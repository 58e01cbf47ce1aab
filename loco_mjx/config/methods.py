"""What a method, and the policy that it trains, make of a configuration."""

from __future__ import annotations

import dataclasses

from loco_mjx.config.learning import NetworkConfig
from loco_mjx.config.tree import Config


def teacher_of(config: Config) -> Config:
    """The configuration of the teacher's run, for a run of method `distill`.

    Where its exploration narrows, its learning rate falls: the same step changes a narrow Gaussian by more.
    """
    distill = config.distill
    depth = dataclasses.replace(config.env.observation.depth, enabled=False)
    observation = dataclasses.replace(config.env.observation, depth=depth)
    reward = dataclasses.replace(config.env.reward, collision=config.env.reward.collision + distill.teacher_collision)
    env = dataclasses.replace(config.env, observation=observation, reward=reward)
    total = round(distill.teacher_ratio * config.ppo.total_steps)
    network = dataclasses.replace(config.network, critic="shared", initial_std=NetworkConfig.initial_std)
    ppo = dataclasses.replace(config.ppo, total_steps=total, optimizer="joint", final_std=distill.teacher_std)
    if distill.teacher_std is not None:
        ppo = dataclasses.replace(ppo, learning_rate_decay=True)
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
