"""Several seeds in one program, as run directories: each is an ordinary run, and they stay together."""

from __future__ import annotations

import csv
import dataclasses
import io
import json

import jax
import jax.numpy as jp
import numpy as np
import pytest
from rich.console import Console

from loco_mjx.cli.main import main
from loco_mjx.run import checkpoint, directory, loop, start
from loco_mjx.run.learner import Single
from loco_mjx.run.progress import Reporter
from loco_mjx.run.run_log import Run
from tests.cli.test_train import RUN, SMALL, refused
from tests.refusals import refusal, says
from tests.run.tiny import Interrupted, tiny_config, tiny_seeds, tiny_trainer

SEEDS = (2, 0)
EVERY = loop.LoopOptions(checkpoint_minutes=0.0, evaluations=0)


class Killed(BaseException):
    """Stands for a kill: nothing catches it."""


@pytest.fixture
def reporter():
    return Reporter(Console(file=io.StringIO()), 384, 0)


@pytest.fixture
def command(monkeypatch, tmp_path):
    """The real command in an empty directory, with a tiny environment in place of the robot."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(start, "build", tiny_trainer)
    monkeypatch.setattr(start, "group", _group)
    return main


def _group(trainer, runs):
    seeds = tuple(run.config.seed for run in runs)
    return tiny_seeds(trainer.config, seeds) if len(runs) > 1 else Single(trainer)


def _runs(folder, iterations=6):
    runs = []
    for seed in SEEDS:
        (folder / f"seed{seed}").mkdir(parents=True, exist_ok=True)
        runs.append(Run(dataclasses.replace(tiny_config(iterations), seed=seed), folder / f"seed{seed}"))
    return runs


def _learner():
    return tiny_seeds(tiny_config(), SEEDS)


def _state(run):
    """What a single run would go on from."""
    trainer = tiny_trainer(run.config)
    state, samples = checkpoint.restore(run.directory, trainer.init(), run.config, print)
    return jax.tree.map(np.asarray, state), samples


def _rows(folder):
    with (folder / "metrics.csv").open() as file:
        return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in csv.DictReader(file)]


def _files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and "lock" not in path.name}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Runs that nothing interrupted."""
    runs = _runs(tmp_path_factory.mktemp("whole"))
    quiet = Reporter(Console(file=io.StringIO()), 384, 0)
    loop.run_group(_learner(), runs, loop.LoopOptions(60.0, 0), quiet, [])
    return runs


@pytest.mark.parametrize("save", [1, 3, 7])
def test_a_kill_between_the_seeds_checkpoints_and_a_resumption_change_nothing(
    tmp_path, reporter, monkeypatch, whole, save
):
    """Saves are numbered over seeds: the 1st and 2nd are of the start, an even one completes its iteration's."""
    parts = _runs(tmp_path)
    real, count = checkpoint.save, [0]

    def killed(*args):
        real(*args)
        count[0] += 1
        if count[0] == save:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "save", killed)
        with pytest.raises(Killed):
            loop.run_group(_learner(), parts, EVERY, reporter, [])
    outcome = loop.run_group(_learner(), parts, EVERY, reporter, [])
    assert outcome == loop.Outcome(192)
    for run, expected in zip(parts, whole, strict=True):
        (state, samples), (wanted, _) = _state(run), _state(expected)
        assert samples == int(state.samples) == 192
        jax.tree.map(np.testing.assert_array_equal, state, wanted)
        assert np.array_equal(state.key, jax.random.PRNGKey(run.config.seed))
        assert _rows(run.directory) == _rows(expected.directory)
        assert [int(row["step"]) for row in _rows(run.directory)] == [32, 64, 96, 128, 160, 192]
    assert _rows(parts[0].directory) != _rows(parts[1].directory)


def test_a_seed_that_diverges_stops_and_the_others_do_not(tmp_path, reporter):
    class Diverging(Interrupted):
        """The loss of the second seed is no number in the third iteration."""

        def iterate(self, state, pool):
            self.left -= 1
            state, metrics = self.learner.iterate(state, pool)
            spoilt = metrics["loss/total"].at[1].set(jp.nan)
            return state, metrics | ({"loss/total": spoilt} if self.left == 0 else {})

    runs = _runs(tmp_path)
    with refusal("diverged 64 seed0 checkpoint"):
        loop.run_group(Diverging(_learner(), 3, None), runs, EVERY, reporter, [])
    assert checkpoint.steps(runs[0].directory)[0] == 192 and checkpoint.steps(runs[1].directory) == [64, 32]
    assert len(_rows(runs[0].directory)) == 6 and len(_rows(runs[1].directory)) == 2
    with refusal("checkpoint seed2 192 seed0 64"):
        loop.run_group(_learner(), runs, EVERY, reporter, [])


def test_each_seed_is_evaluated_and_progress_shows_means(tmp_path):
    page = io.StringIO()
    runs = _runs(tmp_path, iterations=2)
    evaluations = [lambda state, i=i: {"distance": float(i), "key": float(state.key[1])} for i in range(2)]
    options = loop.LoopOptions(60.0, evaluations=1)
    loop.run_group(_learner(), runs, options, Reporter(Console(file=page), 128, 0), evaluations)
    for i, run in enumerate(runs):
        assert [row["eval/distance"] for row in _rows(run.directory)] == [f"{float(i)}"] * 2
        assert _rows(run.directory)[0]["eval/key"] == f"{float(run.config.seed)}"
    returns = [float(_rows(run.directory)[-1]["episode/return"]) for run in runs]
    last = page.getvalue().splitlines()[-1]
    assert says(last, f"128/128 return {sum(returns) / 2:.1f}")


def test_the_command_makes_ordinary_runs_that_go_on_together_and_alone(command, capsys, tmp_path):
    words = ["train", *SMALL, "--seeds", "0,2", "--total-steps"]
    assert command([*words, "96"]) == 0
    home = tmp_path / "runs" / "thin" / "state-only"
    assert sorted(entry.name for entry in home.iterdir()) == ["seed0", "seed2"]
    for seed in (0, 2):
        folder = home / f"seed{seed}"
        assert directory.load_config(folder).seed == seed
        assert json.loads((folder / "info.json").read_text())["command"] == ["loco-mjx", *words, "96"]
        assert len(_rows(folder)) == 3 and list((folder / "tensorboard").iterdir())
        manifest = json.loads((checkpoint.path_of(folder, 96) / "manifest.json").read_text())
        assert manifest["config"]["seed"] == seed
    assert "runs/thin/state-only/seed*/metrics.csv" in capsys.readouterr().out.replace("\n", "")
    assert command([*words, "96"]) == 0
    assert says(capsys.readouterr().out, "finished")
    assert command([*words, "128"]) == 0
    assert says(capsys.readouterr().out, "resuming 96")

    # The same directories are what a single run takes them for.
    assert command(["train", *SMALL, "--seed", "2", "--total-steps", "160"]) == 0
    assert says(capsys.readouterr().out, "resuming 128")
    assert len(_rows(home / "seed2")) == 5
    assert command([*words, "192"]) == 0  # both have 128, and go back to it together
    assert says(capsys.readouterr().out, "resuming 128")
    assert [len(_rows(home / name)) for name in ("seed0", "seed2")] == [6, 6]


BAD = {
    "backwards": (["--seeds", "4-0"], "4-0 0-4"),
    "letters": (["--seeds", "a"], "'a' 0-4"),
    "empty": (["--seeds", ""], "'' 0-4"),
    "twice": (["--seeds", "0-2,1"], "0-2,1 twice"),
    "both": (["--seeds", "0-1", "--seed", "3"], "--seed --seeds"),
    "both=": (["--seeds=0-1", "--seed=3"], "--seed --seeds"),
    "file": (["--seeds", "0-1", "--out", "/dev/null"], "/dev/null"),
}


@pytest.mark.parametrize(("words", "said"), BAD.values(), ids=BAD.keys())
def test_seeds_that_mean_nothing_are_one_line_and_nothing_is_written(command, capsys, tmp_path, words, said):
    line = refused(capsys, *RUN, *words)
    assert says(line, said), line
    assert list(tmp_path.iterdir()) == []


def test_directories_that_hold_something_else_are_left_alone(command, capsys, tmp_path):
    (tmp_path / "runs" / "thin" / "state-only" / "seed1").mkdir(parents=True)
    (tmp_path / "runs" / "thin" / "state-only" / "seed1" / "data.txt").write_text("precious")
    assert "data.txt" in refused(capsys, *RUN, "--seeds", "0-1")
    assert command([*RUN, "--out", "single"]) == 0
    assert command([*RUN, "--out", "group/seed1", "--seed", "1"]) == 0
    before = _files(tmp_path)
    assert says(refused(capsys, *RUN, "--seeds", "0-1", "--out", "single"), "single run")
    assert says(refused(capsys, *RUN, "--seeds", "0-1", "--out", "group"), "seed0 0 seed1 192")
    assert "env.reward.alive" in refused(capsys, *RUN, "--seeds", "0-1", "--out", "group", "--env.reward.alive", "0.5")
    assert _files(tmp_path) == before
