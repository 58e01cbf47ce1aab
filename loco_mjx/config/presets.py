"""The presets: which values a run starts from."""

from __future__ import annotations

import dataclasses

from loco_mjx import controllers
from loco_mjx.config.controllers import with_controller
from loco_mjx.config.tree import Config, RandomizationConfig
from loco_mjx.errors import UnknownNameError
from loco_mjx.robots import DEFAULT, get_robot


def _fast(config: Config) -> Config:
    """Tuned for wall-clock: fewer passes, larger steps, calmer hips, values of order 1 beside the policy's gradient.

    A teacher pays for collisions.
    """
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
    distill = dataclasses.replace(config.distill, teacher_collision=2.0)
    return dataclasses.replace(config, env=dataclasses.replace(config.env, action=action), ppo=ppo, distill=distill)


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


def with_robot(config: Config, name: str) -> Config:
    """The configuration for a robot, by name or path.

    What was the former robot's own, gains, what an action of 1 means, the latency that is drawn (a control step at
    most), becomes this one's; what was chosen stays.

    Raises:
        UnknownNameError: if there is no robot of that name.
        UserError: if its MJCF does not fit.
    """
    before, robot, env = get_robot(config.env.robot), get_robot(name), config.env
    own, drawn = RandomizationConfig.latency, env.randomization
    short, former = ((own[0], min(own[1], 1 / one.policy_hz)) for one in (robot, before))
    if drawn.latency == former:
        drawn = dataclasses.replace(drawn, latency=short)
    scale = robot.action_scale if env.action.scale == before.action_scale else env.action.scale
    return dataclasses.replace(
        config,
        env=dataclasses.replace(
            env,
            robot=name,
            kp=robot.kp if env.kp == before.kp else env.kp,
            kd=robot.kd if env.kd == before.kd else env.kd,
            action=dataclasses.replace(env.action, scale=scale),
            randomization=drawn,
        ),
    )


PRESETS = {"paper": _paper, "fast": _fast, "real": _real}


def preset(name: str, robot: str = DEFAULT, controller: str = controllers.DEFAULT) -> Config:
    """The configuration of a preset for a robot under a controller.

    Raises:
        UnknownNameError: if there is no preset, no robot, or no controller, of that name.
        UserError: if the robot's MJCF does not fit.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return with_controller(with_robot(PRESETS[name](Config()), robot), controller)
