"""What a run evaluates while it trains: its own task, and those asked for besides, under names of their own."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jp
import pytest

from loco_mjx.cli import train
from loco_mjx.errors import UnknownNameError, UserError
from loco_mjx.evaluation import in_training
from loco_mjx.run import loop
from loco_mjx.run.run_log import Run
from tests.run.tiny import TinyEnv, tiny_config, tiny_trainer


class TaskEnv(TinyEnv):
    """The tiny environment, whose goal is farther on the mountain."""

    def __init__(self, config):
        self.goal = 3.0 if config.task == "mountain" else 1.0

    def reset(self, key):
        return self.observe(self.reset_to(key, jp.full((), self.goal)))


def test_other_tasks_are_evaluated_beside_the_own_one(tmp_path, monkeypatch):
    monkeypatch.setattr(in_training, "LocoEnv", TaskEnv)
    config = tiny_config()
    trainer = tiny_trainer(config)
    options = loop.LoopOptions(evaluation_episodes=2)
    make = in_training.evaluators(options, ["thin", "mountain"])  # thin is its own
    (evaluate,) = make([Run(config, tmp_path)], trainer)
    state = trainer.init()
    found = evaluate(state)
    own = {name for name in found if not name.startswith("mountain/")}
    assert {"distance", "return", "length"} <= own
    assert set(found) == own | {f"mountain/{name}" for name in own}
    assert found["mountain/distance"] == found["distance"]
    assert found["mountain/return"] == pytest.approx(found["return"] - 2.0 * found["length"], abs=1e-4)
    # What is evaluated is the policy, and not what explores.
    other = jax.tree.map(lambda x: x + 1.0, state.params)
    assert evaluate(dataclasses.replace(state, params=other)) == found
    assert evaluate(dataclasses.replace(state, mean=other))["distance"] != found["distance"]


@pytest.mark.parametrize(("listed", "error"), [("wide,moutain", UnknownNameError), ("wide,,thin", UserError)])
def test_a_list_of_tasks_is_checked(listed, error):
    assert train.other_tasks(train.read(["--eval-tasks", "wide,thin,wide"])) == ["wide", "thin"]
    assert train.other_tasks(train.read([])) == []
    with pytest.raises(error):
        train.other_tasks(train.read(["--eval-tasks", listed]))
