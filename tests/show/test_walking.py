"""`play --controller mpc`: the environment's episodes, walked by the whole-body controller."""

import dataclasses

import numpy as np

from loco_mjx.config import DepthConfig
from loco_mjx.show.rollout import Agent, Rollout
from tests.light import LIGHT


def test_it_walks_in_the_tasks_scenes():
    agent = Agent("mpc", command=(0.4, 0.0))
    config = agent.env_config("thin")
    blind = dataclasses.replace(config.observation, depth=DepthConfig(enabled=False))
    rollout = Rollout(agent, dataclasses.replace(config, observation=blind, physics=LIGHT))
    first = rollout.reset(3)
    moments = [rollout.step() for _ in range(32)]
    assert not any(moment.done for moment in moments) and rollout.unsolved == 0
    last = moments[-1]
    assert last.step == 32 and 0.35 < last.distance < 0.75  # 1.6 s, from standing
    np.testing.assert_allclose(last.qpos[0] - first.qpos[0], last.distance, atol=1e-4)
