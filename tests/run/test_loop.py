import contextlib
import csv
import dataclasses
import io
import os
import shutil
import signal

import jax
import jax.numpy as jp
import numpy as np
import pytest
from rich.console import Console

from loco_mjx.errors import RunError
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.run import checkpoint, loop, run_log
from loco_mjx.run.progress import Output, Reporter
from loco_mjx.run.signals import Interrupt
from tests.refusals import refusal, says
from tests.run.tiny import Interrupted, TinyEnv, Wordy, file_limit, mesh, tiny_config, tiny_trainer

EVERY = loop.LoopOptions(checkpoint_minutes=0.0, evaluations=0)
AT_THE_END = loop.LoopOptions(checkpoint_minutes=60.0, evaluations=0)


@pytest.fixture(scope="module")
def trainer():
    return tiny_trainer(tiny_config())


@pytest.fixture
def reporter():
    return Reporter(Console(file=io.StringIO()), 192, 0)


def rows(directory):
    with (directory / "metrics.csv").open() as file:
        return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in csv.DictReader(file)]


def final_state(trainer, directory, config):
    state, samples = checkpoint.restore(directory, trainer.init(), config, print)
    return jax.tree.map(np.asarray, state), samples


def same(a, b):
    return all(
        np.array_equal(x, y, equal_nan=True) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    )


class Killed(BaseException):
    """Stands for a kill: nothing catches it."""


def die():
    raise Killed


def test_resuming_gives_bit_for_bit_what_an_uninterrupted_run_gives(tmp_path, trainer, reporter):
    config, whole, parts = tiny_config(), tmp_path / "whole", tmp_path / "parts"
    whole.mkdir(), parts.mkdir()
    loop.run(trainer, config, whole, AT_THE_END, reporter)

    with pytest.raises(Killed):  # after 3 iterations and their checkpoint, within a pool's life
        loop.run(Interrupted(trainer, 4, die), config, parts, EVERY, reporter)
    assert checkpoint.steps(parts) == [96, 64]
    outcome = loop.run(trainer, config, parts, EVERY, reporter)

    assert outcome == loop.Outcome(samples=192, signal=None)
    expected, samples = final_state(trainer, whole, config)
    resumed, resumed_samples = final_state(trainer, parts, config)
    assert samples == resumed_samples == int(expected.samples) == 192
    assert same(expected, resumed)
    assert not same(expected.params, jax.tree.map(np.asarray, trainer.init().params))
    policy, _ = checkpoint.restore(parts, run_log.policy_of(expected), config, print, checkpoint.POLICY)
    assert same(policy, {"params": expected.mean, "normalizer": expected.normalizer})
    assert not same(expected.mean, expected.params)
    assert rows(parts) == rows(whole)
    assert [int(row["step"]) for row in rows(parts)] == [32, 64, 96, 128, 160, 192]


def test_rows_after_the_checkpoint_are_made_again_once(tmp_path, trainer, reporter):
    config = tiny_config()
    with pytest.raises(Killed):  # checkpoints at 32, 64, 96; then the last one is lost: rows up to 96 stand
        loop.run(Interrupted(trainer, 4, die), config, tmp_path, EVERY, reporter)
    before = rows(tmp_path)
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("128,0.5")  # a row that the kill cut short
    manifest = checkpoint.path_of(tmp_path, 96) / "manifest.json"
    manifest.write_text(manifest.read_text()[:100])
    loop.run(trainer, config, tmp_path, AT_THE_END, reporter)
    assert [int(row["step"]) for row in rows(tmp_path)] == [32, 64, 96, 128, 160, 192]
    assert rows(tmp_path)[:3] == before


def sending(trainer, number, iteration):
    return Interrupted(trainer, iteration, lambda: os.kill(os.getpid(), number))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_saves_after_the_iteration_and_stops(tmp_path, trainer, reporter, number):
    config = tiny_config()
    handler = signal.getsignal(number)
    assert loop.run(sending(trainer, number, 2), config, tmp_path, AT_THE_END, reporter) == loop.Outcome(64, number)
    assert checkpoint.steps(tmp_path) == [64]
    assert signal.getsignal(number) is handler


def test_a_closed_terminal_does_not_stop_what_nohup_started(tmp_path, trainer, reporter):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        stopped = sending(trainer, signal.SIGHUP, 2)
        assert loop.run(stopped, tiny_config(3), tmp_path, AT_THE_END, reporter) == loop.Outcome(96)
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_before_the_first_iteration_is_done_leaves_at_once(tmp_path, trainer, reporter, number):
    stopped = sending(trainer, number, 1)
    assert loop.run(stopped, tiny_config(), tmp_path, AT_THE_END, reporter) == loop.Outcome(0, number)
    assert checkpoint.steps(tmp_path) == []
    loop.run(trainer, tiny_config(2), tmp_path, AT_THE_END, reporter)
    stopped = sending(trainer, number, 1)
    assert loop.run(stopped, tiny_config(), tmp_path, AT_THE_END, reporter) == loop.Outcome(64, number)
    assert checkpoint.steps(tmp_path) == [64]


def swallowed():
    """Ctrl-C while a library runs that lets no exception through."""
    with contextlib.suppress(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_that_a_library_swallows_is_not_forgotten(tmp_path, trainer, reporter):
    stopped = Interrupted(trainer, 1, swallowed)
    assert loop.run(stopped, tiny_config(), tmp_path, AT_THE_END, reporter) == loop.Outcome(32, signal.SIGINT)
    with Interrupt():
        swallowed()
        with pytest.raises(KeyboardInterrupt):
            loop.run(trainer, tiny_config(), tmp_path, AT_THE_END, reporter)
    assert checkpoint.steps(tmp_path) == [32]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_reader_that_leaves_stops_the_run_as_a_signal_does(tmp_path, trainer):
    read, write = os.pipe()
    os.close(read)
    with contextlib.suppress(BrokenPipeError), open(write, "w") as file:
        reporter = Reporter(Output(file=file), 192, 0)
        outcome = loop.run(trainer, tiny_config(), tmp_path, AT_THE_END, reporter)
    assert outcome == loop.Outcome(32, signal.SIGPIPE) and checkpoint.steps(tmp_path) == [32]


def test_what_is_printed_to_a_full_disk_ends_the_run_with_a_checkpoint(tmp_path, trainer):
    with contextlib.suppress(OSError), open("/dev/full", "w") as file:
        reporter = Reporter(Output(file=file), 192, 0)
        with refusal("printed space saved 32", RunError):
            loop.run(trainer, tiny_config(), tmp_path, AT_THE_END, reporter)
    assert checkpoint.steps(tmp_path) == [32]


def test_a_second_ctrl_c_leaves_at_once(tmp_path, trainer, reporter):
    def twice():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        loop.run(Interrupted(trainer, 2, twice), tiny_config(), tmp_path, AT_THE_END, reporter)
    assert checkpoint.steps(tmp_path) == []


def test_a_diverged_run_does_not_overwrite_its_last_good_checkpoint(tmp_path, trainer, reporter):
    class Diverging:
        def __init__(self):
            self.calls = 0

        init, make_pool = trainer.init, trainer.make_pool

        def iterate(self, state, pool):
            self.calls += 1
            state, metrics = trainer.iterate(state, pool)
            return state, metrics | ({"loss/total": jp.nan} if self.calls == 3 else {})

    with refusal("diverged 64"):
        loop.run(Diverging(), tiny_config(), tmp_path, EVERY, reporter)
    assert checkpoint.steps(tmp_path) == [64, 32]


@pytest.mark.parametrize(
    ("rate", "what"),
    [(float("inf"), "diverged parameters NaN"), (1e30, "diverged 4 updates")],
)
def test_what_diverges_without_a_loss_that_shows_it_stops_too(tmp_path, reporter, rate, what):
    """Updates whose gradient is no number are skipped, and leave no loss behind."""
    config = tiny_config()
    trainer = Trainer(config, TinyEnv(), mesh())
    trainer.config = tiny_config(learning_rate=rate)  # which no configuration that is checked holds
    with refusal(what):
        loop.run(trainer, config, tmp_path, EVERY, reporter)
    for step in checkpoint.steps(tmp_path):
        state, _ = checkpoint.restore(tmp_path, tiny_trainer(config).init(), config, print, at=step)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state.params, state.normalizer)))


def test_observations_beyond_what_squares_can_hold_stop_the_run(tmp_path, reporter):
    config = tiny_config(iterations=3)
    trainer = tiny_trainer(config)

    class Wild:
        init, make_pool = trainer.init, trainer.make_pool

        def iterate(self, state, pool):
            huge = jax.tree.map(lambda x: x, state.env_state.obs) | {"state": state.env_state.obs["state"] * 1e30}
            env_state = dataclasses.replace(state.env_state, obs=huge)
            return trainer.iterate(dataclasses.replace(state, env_state=env_state), pool)

    with refusal("diverged normalizer"):
        loop.run(Wild(), config, tmp_path, EVERY, reporter)
    assert checkpoint.steps(tmp_path) == []


def test_evaluations_are_at_the_start_at_even_distances_and_at_the_end(tmp_path, trainer, reporter):
    options = loop.LoopOptions(checkpoint_minutes=60.0, evaluations=2)
    loop.run(trainer, tiny_config(), tmp_path, options, reporter, lambda state: {"distance": float(state.iteration)})
    assert [row["eval/distance"] for row in rows(tmp_path)] == ["1.0", "", "3.0", "", "", "6.0"]


def test_what_did_best_is_kept_and_what_a_checkpoint_scored_is_its_own_evaluation(tmp_path, trainer, reporter):
    options = loop.LoopOptions(checkpoint_minutes=60.0, evaluations=3, keep_every=33)  # at 1, 2, 4, 6 of 6 iterations
    falling = lambda state: {"return": -float(state.iteration)}  # noqa: E731
    loop.run(trainer, tiny_config(), tmp_path, options, reporter, falling)
    # 64 is past 33, 96 past 66, 128 past 99, 160 past 132, 192 past 165.
    assert checkpoint.steps(tmp_path) == [192, 160, 128, 96, 64, 32]
    assert [checkpoint.score_of(checkpoint.path_of(tmp_path, step)) for step in (192, 96, 32)] == [-6.0, None, -1.0]
    assert checkpoint.choose(tmp_path, "best") == 32


def test_episode_figures_are_left_out_where_no_episode_ended(tmp_path, trainer, reporter):
    # Episodes last 10 steps, an iteration 8: none ends in the first, all do in the second.
    loop.run(trainer, tiny_config(iterations=2), tmp_path, AT_THE_END, reporter)
    first, second = rows(tmp_path)
    assert first["episodes"] == "0.0" and first["episode/length"] == ""
    assert second["episodes"] == "4.0" and second["episode/length"] == "10.0"


def test_plain_progress_names_what_matters(tmp_path, trainer):
    page = io.StringIO()
    reporter = Reporter(Console(file=page), 64, 0)
    loop.run(trainer, tiny_config(iterations=2), tmp_path, AT_THE_END, reporter)
    last = page.getvalue().splitlines()[-1]
    assert says(last, "64/64 samples/s left return distance KL")


def test_curves_that_cannot_be_written_end_the_run_with_a_checkpoint(tmp_path, trainer, reporter):
    """Events grow by 10 kB an iteration here, so that they alone meet the limit; then there is room again."""
    config = tiny_config(12)
    with file_limit(60_000), refusal(f"{tmp_path} room saved", RunError) as error:
        loop.run(Wordy(trainer), config, tmp_path, AT_THE_END, reporter)
    (saved,) = checkpoint.steps(tmp_path)
    assert says(str(error.value), f"{saved}")
    assert 0 < saved < 384
    assert loop.run(Wordy(trainer), config, tmp_path, AT_THE_END, reporter) == loop.Outcome(384)
    assert [int(row["step"]) for row in rows(tmp_path)] == list(range(32, 385, 32))


def test_a_disk_that_takes_no_checkpoint_either_keeps_the_last_one(tmp_path, trainer, reporter):
    config = tiny_config()
    loop.run(trainer, tiny_config(3), tmp_path, AT_THE_END, reporter)
    before = rows(tmp_path)
    with file_limit((tmp_path / "metrics.csv").stat().st_size + 10), refusal("96", RunError):
        loop.run(trainer, config, tmp_path, AT_THE_END, reporter)
    assert checkpoint.steps(tmp_path) == [96] and rows(tmp_path)[:3] == before
    assert loop.run(trainer, config, tmp_path, AT_THE_END, reporter) == loop.Outcome(192)
    assert [int(row["step"]) for row in rows(tmp_path)] == [32, 64, 96, 128, 160, 192]


def test_the_disk_that_fills_up_while_a_checkpoint_is_written_is_named(tmp_path, trainer, reporter):
    loop.run(trainer, tiny_config(1), tmp_path, AT_THE_END, reporter)
    with file_limit(8192), refusal(f"{checkpoint.path_of(tmp_path, 64)} room", RunError):
        loop.run(trainer, tiny_config(2), tmp_path, AT_THE_END, reporter)
    assert checkpoint.steps(tmp_path) == [32]


def test_a_directory_that_is_removed_while_it_trains_ends_the_run_and_stays_removed(tmp_path, trainer, reporter):
    place = tmp_path / "run"
    place.mkdir()
    with refusal(f"{place} removed", RunError):
        loop.run(Interrupted(trainer, 3, lambda: shutil.rmtree(place)), tiny_config(), place, EVERY, reporter)
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_is_moved_keeps_its_last_checkpoint_and_nothing_is_written_in_its_old_place(
    tmp_path, trainer, reporter
):
    place, other = tmp_path / "run", tmp_path / "other"
    place.mkdir()
    with refusal(f"{place} moved", RunError):
        loop.run(Interrupted(trainer, 3, lambda: place.rename(other)), tiny_config(), place, EVERY, reporter)
    assert not place.exists()
    assert loop.run(trainer, tiny_config(), other, EVERY, reporter) == loop.Outcome(192)
    assert [int(row["step"]) for row in rows(other)] == [32, 64, 96, 128, 160, 192]


def test_curves_that_an_editor_replaces_or_removes_while_it_trains_lose_nothing(tmp_path, trainer, reporter):
    curves = tmp_path / "metrics.csv"

    def edit():
        (tmp_path / "new").write_text(curves.read_text())
        (tmp_path / "new").replace(curves)

    learner = Interrupted(Interrupted(trainer, 2, edit), 4, curves.unlink)
    loop.run(learner, tiny_config(), tmp_path, AT_THE_END, reporter)
    assert [int(row["step"]) for row in rows(tmp_path)] == [32, 64, 96, 128, 160, 192]
