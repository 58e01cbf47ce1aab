"""When a run reached the paper's figures, from curves written by hand; and `bench learn`, which trains one."""

import json

import pytest

from loco_mjx.cli import bench
from loco_mjx.cli.main import main
from loco_mjx.compare.time_to_paper import Milestone, milestones, times
from loco_mjx.run import start
from loco_mjx.run.directory import write_json
from tests.compare.runs import write_curve, write_run
from tests.refusals import refusal, says
from tests.run.tiny import tiny_trainer

COLUMNS = ("step", "time/samples_per_second", "eval/distance", "eval/wide/distance")
# A compilation of 1,000 s, then 10 s an iteration; it was started again at 2,000 samples, and compiled for 500 s.
ROWS = ((1000, 1.0, 0.5, 0.1), (2000, 100.0, "", ""), (3000, 2.0, 9.0, 3.0), (4000, 100.0, 7.0, 15.0))

TINY = ("--evaluations", "0", "--num-envs", "4", "--ppo.unroll", "8", "--ppo.minibatch", "16", "--ppo.pool-size", "4")
TINY += ("--env.horizon", "10", "--network.state-only-hidden", "8", "8", "--ppo.learning-rate-decay", "False")


@pytest.fixture
def run(tmp_path):
    path = write_run(tmp_path)
    write_curve(path, COLUMNS, ROWS)
    write_json(path / "info.json", {"samples": 0, "resumed": [{"samples": 2000}]})
    return path


def _named(result):
    return {one["evaluated_on"]: one for one in result["milestones"]}


def test_the_first_evaluation_there_counts_and_compiling_does_not(run):
    wanted = [Milestone("thin", "thin", 8.0), Milestone("thin", "wide", 14.2), Milestone("thin", "moving", 1.0)]
    result = times(run, wanted)
    assert (result["samples"], result["teacher_samples"]) == (4000, 0)
    assert result["minutes"] == pytest.approx(40 / 60)
    found = _named(result)
    assert (found["thin"]["samples"], found["thin"]["best"]) == (3000, 9.0)
    assert found["thin"]["minutes"] == pytest.approx(30 / 60)
    assert found["wide"]["minutes"] == pytest.approx(40 / 60)
    assert not found["moving"]["reached"] and found["moving"]["best"] is None and "samples" not in found["moving"]


def test_a_teacher_s_whole_training_comes_before(run):
    teacher = write_run(run, "teacher", policy="privileged")
    write_curve(teacher, COLUMNS[:2], ((5000, 50.0), (10000, 500.0)))
    write_json(teacher / "info.json", {"samples": 0})
    result = times(run, [Milestone("thin", "thin", 8.0)])
    assert (result["teacher_samples"], result["teacher_minutes"]) == (10000, pytest.approx(20 / 60))
    assert result["milestones"][0]["minutes"] == pytest.approx(50 / 60)
    assert result["minutes"] == pytest.approx(60 / 60)


def test_the_paper_s_distances_are_found_and_a_task_without_one_is_refused(tmp_path):
    assert milestones("mountain") == [Milestone("mountain", "mountain", 6.8)]
    assert milestones("thin") == [Milestone("thin", "wide", 14.2)]
    with refusal("indoor mountain moving thin"):
        milestones("indoor")
    with refusal(f"{tmp_path}/thin/loco-transformer/seed0 curve"):
        times(write_run(tmp_path), [])


def test_bench_learn_trains_and_prints_one_object(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(start, "build", tiny_trainer)
    monkeypatch.setattr(bench, "EVALUATED", TINY)
    words = ["bench", "learn", "--task", "thin", "--policy", "state-only", "--method", "ppo"]
    words += ["--total-steps", "64", "--out", str(tmp_path / "run"), "--json"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["samples"] == 64 and result["milestones"][0]["reached"] is False
    assert main(["bench", "learn", "--task", "hill"]) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["learn", "--robot", "go2"], "--robot learn depth physics env train mpc"),
        (["mpc", "--task", "wide"], "--task mpc depth"),
        (["depth", "--out=x"], "--out depth learn"),
        (["env", "--seeds", "2"], "--seeds env train"),
    ],
)
def test_an_option_that_a_part_does_not_look_at_is_refused(words, said, capsys):
    assert main(["bench", *words]) == 2
    assert says(capsys.readouterr().err, said)
