"""What the documents say in numbers is what the configuration holds and what was measured."""

import json
from pathlib import Path

import pytest

from experiments import committed, document, ordering
from experiments.faults import told
from experiments.paper import EXPERIMENTS
from loco_mjx.compare import paper
from loco_mjx.config import PPOConfig, preset

ROOT = Path(__file__).parents[1]


def text(name):
    return " ".join((ROOT / name).read_text().split())


@pytest.mark.parametrize("name", ["fast", "paper"])
def test_the_readme_says_how_scenes_are_drawn(name):
    ppo: PPOConfig = preset(name).ppo
    assert f"a pool of {ppo.pool_size} and replaces all of them every {ppo.pool_refresh} iterations" in text(
        "README.md"
    )


def test_no_speed_is_claimed_that_no_result_stands_behind():
    """Until a GPU's result is committed, the words say that there is none."""
    devices = set()
    for path in committed.runs().values():
        devices.add(json.loads((path / "info.json").read_text())["devices"]["kind"])
    assert devices == {"cpu"}, "there is a GPU's result: the README and experiments/document.py may say so"
    assert "minutes on a GPU" not in text("README.md") and "on a GPU has not been measured" in text("README.md")
    assert "No run on a GPU has been measured" in document.LEARNING


def test_where_results_are_shown_it_is_said_of_which_preset_they_are():
    assert {experiment.preset for experiment in EXPERIMENTS} == {"paper"}
    keys, authors = ("minibatch", "epochs", "learning_rate"), preset("paper").ppo
    used = [json.loads((path / "config.json").read_text())["ppo"] for path in committed.runs().values()]
    published = any(all(ppo[key] == getattr(authors, key) for key in keys) for ppo in used)
    assert used and not published, "a run of the paper preset is published: the documents may say so"
    for words in (document.LEARNING, ordering.COMPARISON, text("docs/comparing.md")):
        assert "`paper`" in words and "`fast` preset" in " ".join(words.split())


def test_the_results_are_those_of_the_committed_files():
    assert (ROOT / "docs/results.md").read_text() == document.text()


def test_what_is_said_of_teaching_is_what_came_of_it():
    found = [json.loads(path.read_text()) for path in (committed.RESULTS / "taught").glob("mountain-seed*/evaluation*")]
    farthest = [result["metrics"]["distance"]["mean"] for result in found]
    (row,) = (row for row in paper.MOUNTAIN.rows if row.variant.policy == "loco-transformer")
    assert min(farthest) > row.values[0][0]
    for path in (committed.RESULTS / "taught").glob("mountain-seed*"):
        parts = [committed.rows(path / name)[-1]["step"] for name in ("metrics.csv", "teacher-metrics.csv")]
        assert sum(parts) <= 3.05e6
    for path in (committed.RESULTS / "taught").glob("thin-seed*"):
        metrics = json.loads((path / "evaluation-wide.json").read_text())["metrics"]
        assert metrics["distance_16s"]["mean"] > _printed(paper.DISTANCE)
        assert metrics["collisions_16s"]["mean"] < _printed(paper.COLLISIONS)
        parts = [committed.rows(path / name)[-1]["step"] for name in ("metrics.csv", "teacher-metrics.csv")]
        assert sum(parts) <= 2e6
    (summit,) = (committed.RESULTS / "taught").glob("mountain-x8-seed0")
    assert json.loads((summit / "evaluation-mountain.json").read_text())["metrics"]["reached_goal"]["mean"] > 0.8
    last = [committed.rows(summit / name)[-1] for name in ("metrics.csv", "teacher-metrics.csv")]
    assert sum(row["step"] for row in last) <= 9.05e6 and sum(row["time/seconds"] for row in last) < 3600
    reached = "after 9 million, within an hour, it comes to the summit in four of five episodes (one seed)"
    assert reached in text("README.md")
    said = (
        "15 million samples: on `mountain` after 3 million, its teacher's included, and on `wide`, which it has never"
    )
    assert f"{said} seen, after 2 million on `thin`, with fewer collisions" in text("README.md")


def _printed(metric):
    """The paper's figure of LocoTransformer, trained on thin obstacles, on wide ones."""
    table = paper.GENERALIZATION
    (row,) = (row for row in table.rows if row.variant.policy == "loco-transformer")
    where = [(column.trained_on, column.evaluated_on, column.metric) for column in table.columns]
    return row.values[where.index(("thin", "wide", metric))][0]


def test_reliability_is_what_the_campaign_of_faults_found():
    found, said = json.loads((ROOT / "experiments/results/faults.json").read_text()), text("docs/reliability.md")
    assert " ".join(told.table(found).split()) in said
    problems = {name: part["problems"] for name, part in found.items() if part["problems"]}
    assert problems == {}, "say in docs/reliability.md what is not as it should be"
