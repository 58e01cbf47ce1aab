import json
import os
import shutil
import signal
import sys

import jax
import numpy as np
import pytest

from loco_mjx.cli import train
from loco_mjx.cli.main import main
from loco_mjx.run import checkpoint, progress, start
from tests.refusals import clear, says
from tests.run.tiny import Interrupted, Wordy, file_limit, tiny_trainer

SMALL = [
    *("--policy", "state-only", "--preset", "paper", "--num-envs", "4", "--ppo.unroll", "8", "--ppo.minibatch", "16"),
    *("--ppo.epochs", "2", "--ppo.pool-size", "4", "--ppo.pool-refresh", "2", "--network.state-only-hidden", "8", "8"),
    *("--evaluations", "0", "--ppo.learning-rate-decay", "False"),
]
RUN = ["train", *SMALL, "--total-steps", "192"]


def without(option):
    """RUN without an option of one value."""
    place = RUN.index(option)
    return RUN[:place] + RUN[place + 2 :]


@pytest.fixture(autouse=True)
def tiny(monkeypatch, tmp_path):
    """The real command in an empty directory, with a tiny environment in place of the robot."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(start, "build", tiny_trainer)


def refused(capsys, *args):
    """Runs a command that must be refused; returns what it says."""
    assert main(args) == 2
    err = capsys.readouterr().err
    assert clear(err), err
    return err


BAD = {
    "verb": (["trian"], "trian train evaluate"),
    "task": (["train", "--task", "thinn"], "task thinn thin mountain"),
    "policy": (["train", "--policy", "loco-tranformer"], "policy loco-tranformer loco-transformer state-only"),
    "preset": (["train", "--preset", "papr"], "preset papr paper fast"),
    "preset=": (["train", "--preset=papr"], "preset papr paper fast"),
    "option": (["train", "--sed", "3"], "--sed --seed"),
    "key": (["train", "--ppo.clipp", "3"], "--ppo.clipp --ppo.clip"),
    "value": (["train", "--seed", "x"], "--seed x"),
    "seed": (["train", "--seed", "99999999999999999999"], "seed 99999999999999999999 2147483647"),
    "minibatch": ([*without("--ppo.minibatch"), "--ppo.minibatch", "5"], "ppo.minibatch 5 32"),
    "none": ([*without("--num-envs"), "--num-envs", "0"], "num-envs 0 1 1048576"),
    "negative": ([*without("--total-steps"), "--total-steps", "-5"], "total-steps -5 1 2000000000"),
    "tokens": (["train", "--network.tokens-per-side", "3"], "--network.tokens-per-side 3"),
    "two tasks": (["train", "--task", "thin", "--env.task", "wide"], "--task thin --env.task wide"),
    "controller": (["train", "--controller", "mcp"], "controller mcp mpc pd"),
    "two controllers": (
        ["train", "--controller", "pd", "--env.controller", "mpc"],
        "--controller pd --env.controller mpc",
    ),
    "last action": (
        ["train", "--controller", "mpc", "--env.observation.last-action", "True"],
        "env.observation.last_action True mpc False",
    ),
    "two sizes": ([*RUN, "--ppo.num-envs", "8"], "--num-envs 4 --ppo.num-envs 8"),
    "two totals": ([*RUN, "--ppo.total_steps=8"], "--total-steps 192 --ppo.total-steps 8"),
    "two presets": (["train", "--preset", "fast", "--preset", "paper"], "--preset twice fast paper"),
    "two seeds": ([*RUN, "--seed", "1", "--seeds", "1-2"], "--seed --seeds"),
    "no depth": (["train", "--preset", "fast", "--env.observation.depth.enabled", "False"], "depth loco-transformer"),
    "a pupil without depth": (
        ["train", "--method", "distill", "--env.observation.depth.enabled", "False"],
        "depth loco-transformer",
    ),
    "a pupil's hold": (
        ["train", "--method", "distill", "--policy", "hrl", "--network.hold", "5"],
        "network.hold 5 ppo.unroll 32",
    ),
    "what a pupil sees": (
        ["train", "--method", "distill", "--env.observation.depth.height", "48"],
        "env.observation.depth 48 64 square 36",
    ),
    "file": ([*RUN, "--out", "/dev/null"], "/dev/null file"),
    "access": ([*RUN, "--out", "/proc/run"], "/proc/run"),
    "below a file": ([*RUN, "--out", "/dev/null/run"], "/dev/null/run"),
}


@pytest.mark.parametrize(("args", "words"), BAD.values(), ids=BAD.keys())
def test_a_mistake_is_named_and_nothing_is_written(args, words, capsys, tmp_path):
    said = refused(capsys, *args)
    assert says(said, words), said
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_directory_is_left_alone(capsys, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "data.txt").write_text("precious")
    assert "data.txt" in refused(capsys, *RUN, "--out", "mine")
    assert [entry.name for entry in (tmp_path / "mine").iterdir()] == ["data.txt"]


@pytest.mark.parametrize("content", ["[]", '{"resumed": 3}', "7", "{"])
def test_a_record_of_starts_that_is_none_is_refused_before_anything_is_written(content, capsys, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "info.json").write_text(content)  # as a kill before the configuration leaves it
    assert "info.json" in refused(capsys, *RUN, "--out", "run")
    assert [entry.name for entry in (tmp_path / "run").iterdir()] == ["info.json"]


def test_a_directory_of_another_run_is_left_alone(capsys, tmp_path):
    assert main([*RUN, "--out", "run"]) == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    capsys.readouterr()
    said = refused(capsys, *RUN, "--out", "run", "--env.reward.alive", "0.5")
    assert says(said, "env.reward.alive 0.1 0.5"), said
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def _cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _loop(path):
    path.rename(path.with_name("old"))
    path.symlink_to(path)


REFUSED = {
    "checkpoints": (
        lambda run: [_cut(path) for path in run.glob("checkpoints/*/manifest.json")],
        "manifest.json checkpoints",
    ),
    "states": (lambda run: [_cut(path) for path in run.glob("checkpoints/*/state/_METADATA")], "_METADATA checkpoints"),
    "loop": (lambda run: _loop(run / "checkpoints"), "checkpoints links"),
    "lock": (lambda run: _loop(run / "lock"), "lock link"),
    "curves": (lambda run: ((run / "metrics.csv").unlink(), (run / "metrics.csv").mkdir()), "metrics.csv directory"),
}


@pytest.mark.parametrize(("harm", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_go_on_is_one_line_and_nothing_is_written(harm, words, capsys, tmp_path):
    assert main([*RUN[:-1], "32", "--out", "run"]) == 0
    harm(tmp_path / "run")
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    capsys.readouterr()
    said = refused(capsys, *RUN, "--out", "run")
    assert says(said, words), said
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


def test_ctrl_c_saves_says_how_to_go_on_and_that_ends_like_an_uninterrupted_run(capsys, tmp_path, monkeypatch):
    assert main([*RUN, "--out", "whole"]) == 0
    interrupt = lambda: os.kill(os.getpid(), signal.SIGINT)  # noqa: E731
    monkeypatch.setattr(sys, "argv", ["/somewhere/loco-mjx"])
    with monkeypatch.context() as patch:
        patch.setattr(start, "build", lambda config: Interrupted(tiny_trainer(config), 3, interrupt))
        capsys.readouterr()
        assert main([*RUN, "--out", "parts"]) == 130
    last = capsys.readouterr().out.splitlines()[-1]
    assert says(last, "96") and last.endswith("/somewhere/loco-mjx " + " ".join([*RUN, "--out", "parts"]))

    assert main(last.partition("loco-mjx ")[2].split()) == 0
    states = []
    for name in ("whole", "parts"):
        config = train.configuration(train.read([*RUN[1:], "--out", name]))
        trainer = tiny_trainer(config)
        states.append(checkpoint.restore(tmp_path / name, trainer.init(), config, print))
    assert states[0][1] == states[1][1] == 192
    for a, b in zip(*(jax.tree.leaves(state) for state, _ in states), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


def test_ctrl_c_is_one_line_whatever_a_library_makes_of_it(capsys, monkeypatch, tmp_path):
    def build(config):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt as error:
            raise ImportError("a half-imported library") from error

    monkeypatch.setattr(start, "build", build)
    assert main([*RUN, "--out", "run"]) == 130
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("loco-mjx: ") and "library" not in line
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_leaves_is_told_on_stderr_how_to_go_on(capsys, tmp_path, monkeypatch):
    read, write = os.pipe()
    monkeypatch.setattr(start, "build", lambda config: Interrupted(tiny_trainer(config), 3, lambda: os.close(read)))
    monkeypatch.setattr(progress, "LINE_SECONDS", 0.0)
    with open(write, "w") as file, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", file)
        assert main([*RUN, "--out", "run"]) == 128 + signal.SIGPIPE
    assert checkpoint.steps(tmp_path / "run")[0] == 96
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("loco-mjx: ") and says(line, "96") and line.endswith(" ".join([*RUN, "--out", "run"]))


def test_a_full_disk_is_one_line_and_exit_code_1_and_the_same_command_goes_on(capsys, monkeypatch):
    monkeypatch.setattr(start, "build", lambda config: Wordy(tiny_trainer(config)))
    command = [*RUN[:-1], "384", "--out", "run"]
    with file_limit(60_000):
        assert main(command) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("loco-mjx: ") and says(line, "run larger saved")
    assert main(command) == 0
    assert says(capsys.readouterr().out, "finished 384")


def test_a_finished_run_says_so_and_can_be_extended(capsys, tmp_path):
    assert main(RUN) == 0
    assert says(capsys.readouterr().out, "finished 192")
    assert main(RUN) == 0
    assert says(capsys.readouterr().out, "finished")
    assert main([*RUN[:-1], "256"]) == 0
    assert says(capsys.readouterr().out, "resuming 192")
    folder = tmp_path / "runs" / "thin" / "state-only" / "seed0"
    assert checkpoint.steps(folder)[0] == 256
    info = json.loads((folder / "info.json").read_text())
    assert info["samples"] == 0 and info["resumed"][0]["samples"] == 192
    assert info["command"][:2] == ["loco-mjx", "train"]


@pytest.mark.parametrize("harm", ["empty", "damaged", "renamed"])
def test_a_run_whose_last_checkpoint_is_not_whole_is_not_finished(harm, capsys, tmp_path):
    longer = [*RUN[:-1], "256"] if harm == "renamed" else RUN
    assert main([*RUN[:-1], "96", "--out", "run"]) == main([*RUN, "--out", "run"]) == 0
    last = checkpoint.path_of(tmp_path / "run", 192)
    if harm == "damaged":
        max((path for path in last.rglob("state/**/*") if path.is_file()), key=os.path.getsize).write_bytes(b"")
    elif harm == "empty":
        shutil.rmtree(last)
        last.mkdir()
    else:
        last = last.rename(checkpoint.path_of(tmp_path / "run", 256))
    capsys.readouterr()
    assert main([*longer, "--out", "run"]) == 0
    assert says(capsys.readouterr().out, f"{last.name} 96 finished")
    assert checkpoint.whole_steps(tmp_path / "run", print)[0] == int(longer[-1])


def test_a_run_is_resumed_to_its_own_length_where_none_is_given(capsys, tmp_path):
    assert main(RUN) == 0
    capsys.readouterr()
    assert main(RUN[:-2]) == 0
    assert says(capsys.readouterr().out, "finished")


def test_the_policy_decides_whether_depth_is_rendered():
    blind = train.configuration(train.read(["--policy", "state-only"]))
    seeing = train.configuration(train.read(["--policy", "depth-only"]))
    assert not blind.env.observation.depth.enabled and seeing.env.observation.depth.enabled


def test_a_teacher_is_trained_first_and_its_run_is_where_the_policys_is(monkeypatch, tmp_path, capsys):
    """Both parts by the tiny learner: what is asked of them, in which order, and what a repeated command does."""
    built, met = [], []

    def meet(action):
        """Where processes wait for each other."""
        met.append((len(built), checkpoint.newest(tmp_path / "run" / "teacher")))
        action()

    def note(config, *teacher):
        built.append((config, *teacher))
        return tiny_trainer(train.configuration(train.read(RUN[1:])))

    monkeypatch.setattr(start, "build", note)
    monkeypatch.setattr(start, "build_student", note)
    monkeypatch.setattr(start.collectives, "on_first", meet)
    command = [*RUN, "--method", "distill", "--distill.teacher-ratio", "2", "--distill.minibatch", "16", "--out", "run"]
    assert main(command) == 0
    (teacher, *_), (student, place) = built
    assert (1, 384) in met  # nobody reads the teacher before all of it is written
    assert str(place) == "run/teacher" and start.finished(place, teacher)
    assert teacher.policy == "privileged" and teacher.ppo.total_steps == 2 * 192
    assert student.policy == "state-only" and student.method == "distill" and student.network.critic == "privileged"
    place.rename(tmp_path / "apart")
    assert main(["224" if word == "192" else word for word in command]) == 2
    assert says(capsys.readouterr().err, "run/teacher restore")
    (tmp_path / "apart").rename(place)
    assert main(command) == 0 and len(built) == 2
    assert says(capsys.readouterr().out, "finished")
    assert main([*command[:-2], "--seeds", "0-1"]) == 2
    # Where only the teacher is there, it is taken for the teacher of a longer run, and not for another.
    shutil.copytree(place, "other/teacher")
    capsys.readouterr()
    assert main([*command[:-1], "other", "--distill.teacher-collision", "1"]) == 2
    assert says(capsys.readouterr().err, "other/teacher env.reward.collision 0.0 1.0")
    longer = ["224" if word == "192" else word for word in command[:-1]]
    assert main([*longer, "other"]) == 0 and len(built) == 3


def test_the_preset_gives_the_defaults_and_options_override_it():
    paper = train.configuration(train.read(["--preset", "paper", "--ppo.clip", "0.3", "--task", "wide", "--seed", "4"]))
    assert (paper.ppo.learning_rate, paper.ppo.epochs, paper.ppo.clip) == (1e-4, 3, 0.3)
    assert (paper.env.task, paper.seed) == ("wide", 4)
    fast = train.configuration(train.read([]))
    assert fast.env.action.scale == (0.2, 0.5, 0.5)


def test_a_key_and_its_short_form_may_agree_or_stand_alone():
    both = train.configuration(train.read(["--task", "wide", "--env.task", "wide", "--env.task=wide"]))
    assert both == train.configuration(train.read(["--env.task", "wide"]))
    assert both.env.task == "wide"


def test_without_a_budget_a_cpu_gets_one_of_minutes_and_is_told_what_all_would_take(capsys, monkeypatch):
    from loco_mjx.run import machine

    monkeypatch.setattr(machine, "cores", lambda: 2)
    config = train.configuration(train.read(["--policy", "state-only"]))
    total = train.default_total(config)
    assert total < config.ppo.total_steps and total % 100_000 == 0
    said = capsys.readouterr().out
    assert says(said, f"{total:,} 15,000,000")
    assert train.default_total(config, seeds=5) == pytest.approx(total / 5, abs=50_000)
    assert says(capsys.readouterr().out, "seed 20")
    taught = train.configuration(train.read(["--method", "distill"]))
    # By hand: 1/400 s for a sample, 4/4000 s for the teacher's four: 20 minutes of two cores are 686,000 samples.
    assert train.default_total(taught) == 700_000
    walks = train.configuration(train.read(["--method", "distill", "--controller", "mpc"]))
    assert train.default_total(walks) == pytest.approx(2400 / (1 / 150 + 4 / 300), rel=0.5)
    monkeypatch.setattr(machine, "on_cpu", lambda: False)
    assert train.default_total(config) == config.ppo.total_steps


def test_the_start_shows_what_is_observed_rewarded_and_how_large_it_is(capsys):
    assert main(RUN) == 0
    page = capsys.readouterr().out
    assert says(page, "imu 93 forward parameters 4 8")
