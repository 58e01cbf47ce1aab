import dataclasses
import json
import shutil

import jax
import pytest

from experiments import committed, document, ordering
from experiments.committed import BESIDE
from experiments.paper import EXPERIMENTS, cells_of
from loco_mjx.compare import paper
from loco_mjx.config import EnvConfig, flatten, to_dict
from loco_mjx.env import LocoEnv
from tests.refusals import refusal


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    return cells_of([], tmp_path_factory.mktemp("paper"), 1.0)


def test_the_experiments_fill_every_cell_of_the_papers_tables(cells):
    for table in paper.TABLES:
        for row in table.rows:
            for column in table.columns:
                found = [
                    cell
                    for cell in cells
                    if cell.task == column.trained_on
                    and column.evaluated_on in cell.eval_tasks
                    and row.variant.matches(flatten(to_dict(cell.config)))
                ]
                assert [cell.seed for cell in found] == [0, 1, 2, 3, 4], (table.number, row.label, column.title)


def test_no_run_is_made_twice_and_all_are_the_papers_size(cells):
    assert len({cell.path for cell in cells}) == len(cells) == 5 * (6 * 5 + 4)
    assert {cell.config.ppo.total_steps for cell in cells} == {15_000_000}
    assert {(cell.config.ppo.minibatch, cell.config.ppo.epochs) for cell in cells} == {(256, 3)}  # preset `paper`
    assert [cell.seed for cell in cells] == sorted(cell.seed for cell in cells)


def test_every_table_is_named_by_an_experiment_that_fills_it():
    for table in paper.TABLES:
        tasks = {column.trained_on for column in table.columns}
        assert tasks <= {task for one in EXPERIMENTS if table.number in one.tables for task in one.tasks}


def test_every_metric_of_the_tables_is_one_of_the_environment():
    env = EnvConfig()
    depth = dataclasses.replace(env.observation.depth, enabled=False)
    env = dataclasses.replace(env, observation=dataclasses.replace(env.observation, depth=depth))
    metrics = jax.eval_shape(LocoEnv(env).reset, jax.random.PRNGKey(0)).metrics
    wanted = {column.metric for table in paper.TABLES for column in table.columns}
    assert wanted - set(metrics) == {"return"}  # which is the sum of the reward


def test_a_scale_changes_the_samples_alone_until_nothing_would_be_learnt(tmp_path):
    cells = cells_of(["mountain"], tmp_path, 0.01)
    assert {(cell.config.ppo.total_steps, cell.episodes) for cell in cells} == {(150_000, 100)} and len(cells) == 25
    cells = cells_of(["mountain"], tmp_path, 0.0005)
    assert {(cell.config.ppo.total_steps, cell.episodes) for cell in cells} == {(7500, 2)} and len(cells) == 5
    assert {cell.samples for cell in cells} == {8192}  # one iteration


def test_the_smallest_scale_has_every_task_policy_and_ablation_once(tmp_path, cells):
    few = cells_of([], tmp_path, 0.0005)
    assert {cell.task for cell in few} == {cell.task for cell in cells}
    assert {cell.variant for cell in few} == {cell.variant for cell in cells}
    assert len(few) == 6 + 4 + 4 and {cell.seed for cell in few} == {0}
    assert len([cell for cell in few if cell.variant.label == "loco-transformer"]) == 6  # on every task
    assert {cell.config.env.horizon for cell in few} == {100}
    assert all("--evaluations 0" in " ".join(cell.train_command()) for cell in few)


@pytest.mark.parametrize(("names", "scale", "said"), [(["mountains"], 1.0, "mountains mountain"), ([], 0.0, "scale 0")])
def test_mistakes(tmp_path, names, scale, said):
    with refusal(said):
        cells_of(names, tmp_path, scale)


def test_results_made_before_and_after_a_metric_are_documented_alike(tmp_path, monkeypatch):
    """The committed runs as they are, with the new metrics taken away, and with them put in."""
    whole = document.learning() + ordering.comparison()
    assert "| thin-loco-transformer-seed0 |" in whole and "On `wide`:" in whole
    new = {name: {"mean": 1.25, "std": 0.5} for name in BESIDE}
    for name, more in (("old", {}), ("new", new)):
        monkeypatch.setattr(committed, "RESULTS", tmp_path / name)
        shutil.copytree(document.RESULTS / "learning", tmp_path / name / "learning")
        for path in (tmp_path / name).rglob("evaluation*.json"):
            result = json.loads(path.read_text())
            kept = {key: value for key, value in result["metrics"].items() if key not in new}
            path.write_text(json.dumps(result | {"metrics": kept | more}))
    text = document.learning() + ordering.comparison()
    assert "| 1.25 | 1.25 | 1.25 | 1 |" in text and "| 1.25 ± 0.00 | 1.25 ± 0.00 | 1.25 ± 0.00 | 1 ± 0 |" in text
    monkeypatch.setattr(committed, "RESULTS", tmp_path / "old")
    text = document.learning() + ordering.comparison()
    assert "| — | — | — | — |" in text and "1.25" not in text
