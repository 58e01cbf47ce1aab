"""What a run evaluates while it trains: its own task, and those asked for besides, under names of their own."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jp
import pytest

from loco_mjx.cli import train
from loco_mjx.config import Config, EnvConfig
from loco_mjx.errors import UnknownNameError, UserError
from loco_mjx.evaluation.policy import observation_shapes
from loco_mjx.mesh import make_mesh
from loco_mjx.networks.policies import make_networks
from loco_mjx.ppo import normalizer
from loco_mjx.run import loop, start
from loco_mjx.run.record import Run


def test_other_tasks_are_evaluated_beside_the_own_one(tmp_path):
    config = Config(policy="state-only", env=EnvConfig(horizon=3))
    networks = make_networks(config.policy, config.network, config.env.action.size)
    obs = {name: jp.zeros((1, *shape)) for name, shape in observation_shapes(config).items()}
    params = networks.init(jax.random.PRNGKey(0), obs)
    state = SimpleNamespace(params=params, normalizer=normalizer.create(config.env.observation.state_size))
    trainer = SimpleNamespace(networks=networks, mesh=make_mesh())
    options = loop.LoopOptions(evaluation_episodes=2)
    run = Run(config, tmp_path)
    (evaluate,) = start.evaluators([run], trainer, options, ["thin", "mountain"])  # thin is its own
    found = evaluate(state)
    own = {name for name in found if not name.startswith("mountain/")}
    assert {"distance", "collisions", "return"} <= own
    assert set(found) == own | {f"mountain/{name}" for name in own}
    assert found["length"] == found["mountain/length"] == 3.0
    assert found["mountain/distance"] != found["distance"]


@pytest.mark.parametrize(("listed", "error"), [("wide,moutain", UnknownNameError), ("wide,,thin", UserError)])
def test_a_list_of_tasks_is_checked(listed, error):
    assert train.other_tasks(train.read(["--eval-tasks", "wide,thin,wide"])) == ["wide", "thin"]
    assert train.other_tasks(train.read([])) == []
    with pytest.raises(error):
        train.other_tasks(train.read(["--eval-tasks", listed]))
