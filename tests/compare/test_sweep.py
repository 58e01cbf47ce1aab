"""The sweep with a stub in place of the commands: it does to the disk what they would."""

import csv
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from rich.console import Console

from loco_mjx.cli import sweep as sweep_cli
from loco_mjx.cli import train
from loco_mjx.cli.main import main
from loco_mjx.compare import estimate, execute, launch
from loco_mjx.compare.cells import IMPORTS, PROGRAM, Plan
from loco_mjx.config import to_dict
from loco_mjx.run import checkpoint, directory, settings
from loco_mjx.run.schedule import LoopOptions
from loco_mjx.run.variant import Variant, parse_variant
from tests.compare.runs import write_evaluation
from tests.refusals import clear, says

STATE, TRANSFORMER = Variant("state-only"), Variant("loco-transformer")
STEPS = 16_384  # two iterations


class Stub:
    """Trains and evaluates at once; fails where told."""

    def __init__(self, fails=()):
        self.fails, self.ran = fails, []

    def __call__(self, command, log, tick):
        assert tuple(command[: len(PROGRAM)]) == PROGRAM
        verb, words = command[len(PROGRAM)], command[len(PROGRAM) + 1 :]
        self.ran.append((verb, *words))
        log.parent.mkdir(parents=True, exist_ok=True)
        if any(text in " ".join(command) for text in self.fails):
            log.write_text("compiling\nloco-mjx: the disk is full\n")
            return 2
        (self.train if verb == "train" else self.evaluate)(words)
        tick()
        return 0

    def train(self, words):
        options = train.read(words)
        config = train.configuration(options)
        directory.write_json(options.out / "config.json", to_dict(config))
        saved = checkpoint.path_of(options.out, STEPS)
        directory.write_json(saved / checkpoint.MANIFEST, {"step": STEPS, "config": to_dict(config), "files": {}})
        with (options.out / "metrics.csv").open("w") as file:
            csv.writer(file).writerows([["step", "time/seconds"], [8192, 10.0], [STEPS, 16.384]])

    def evaluate(self, words):
        task, episodes = words[words.index("--task") + 1], int(words[words.index("--episodes") + 1])
        metrics = {"distance": 10.0 + 2 * words[0].endswith("seed1"), "collisions": 4.0, "speed": 0.5}
        write_evaluation(Path(words[0]), task, STEPS, episodes, **metrics, collisions_per_metre=0.25)


def cells(out, seeds=(0, 1), **plan):
    values = {"total_steps": STEPS, "eval_tasks": ("thin", "wide")} | plan
    return Plan(out, **values).cells(["thin"], [STATE, TRANSFORMER], seeds)


def run(cells, stub, capsys):
    result = launch.sweep(cells, Console(width=200), launch.Local(stub))
    return result, capsys.readouterr().out


def test_every_cell_is_trained_and_evaluated_and_skipped_the_next_time(tmp_path, capsys):
    stub = Stub()
    result, out = run(cells(tmp_path), stub, capsys)
    assert [cell.name for cell in result.ran] == [
        "thin/state-only/seed0",
        "thin/loco-transformer/seed0",
        "thin/state-only/seed1",
        "thin/loco-transformer/seed1",
    ]
    verbs = [ran[0] for ran in stub.ran]
    assert verbs == ["train", "evaluate", "evaluate"] * 4
    assert (len(result.skipped), len(result.failed)) == (0, 0) and says(out, "4 0")
    assert "16,384/65,536 samples" in out  # of the whole sweep, after the first of its four cells
    again = Stub()
    result, out = run(cells(tmp_path), again, capsys)
    assert again.ran == [] and len(result.skipped) == 4
    assert says(out, "0 4")


def test_it_ends_with_what_was_measured(tmp_path, capsys):
    _, out = run(cells(tmp_path), Stub(fails=["loco-transformer --seed 1"]), capsys)
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if line.startswith("│")]
    measured = [row for row in rows if len(row) == 9]
    own = ["11.00 ± 1.00", "4.0 ± 0.0", "0.25 ± 0.00", "0.50 ± 0.00", "—", "—", "2"]
    assert ["thin", "state-only", *own] in measured and ["thin → wide", "state-only", *own] in measured
    assert ["thin", "loco-transformer", "10.00", "4.0", "0.25", "0.50", "—", "—", "1"] in measured
    # What cannot be read does not hide that the runs have ended.
    write_evaluation(tmp_path / "thin/state-only/seed0", "forest").write_text("{}")
    result, out = run(cells(tmp_path), Stub(), capsys)
    assert not result.failed and says(out, "summary")


def test_more_evaluation_of_finished_runs_trains_nothing(tmp_path, capsys):
    run(cells(tmp_path, seeds=(0,)), Stub(), capsys)
    stub = Stub()
    run(cells(tmp_path, seeds=(0,), eval_tasks=("thin", "mountain")), stub, capsys)
    assert [(ran[0], ran[ran.index("--task") + 1]) for ran in stub.ran] == [("evaluate", "mountain")] * 2
    stub = Stub()
    run(cells(tmp_path, seeds=(0,), eval_tasks=("thin",), episodes=64), stub, capsys)
    assert [ran[0] for ran in stub.ran] == ["evaluate"] * 2


def test_a_failure_stops_nothing_and_is_listed_at_the_end(tmp_path, capsys):
    stub = Stub(fails=["loco-transformer --seed 0"])
    result, out = run(cells(tmp_path), stub, capsys)
    assert len(result.ran) == 3 and [cell.name for cell, _ in result.failed] == ["thin/loco-transformer/seed0"]
    last = out.splitlines()[-1]
    assert says(last, "failed thin/loco-transformer/seed0 train 2 disk full")
    # The failed one alone runs again.
    stub = Stub()
    result, _ = run(cells(tmp_path), stub, capsys)
    assert [ran[0] for ran in stub.ran] == ["train", "evaluate", "evaluate"] and not result.failed


def test_a_failed_evaluation_is_listed_with_its_task(tmp_path, capsys):
    result, _ = run(cells(tmp_path, seeds=(0,)), Stub(fails=["state-only/seed0 --task wide"]), capsys)
    ((cell, why),) = result.failed
    assert cell.name == "thin/state-only/seed0" and says(why, "evaluate wide 2")


def test_a_directory_of_another_run_is_listed_and_left_alone(tmp_path, capsys):
    run(cells(tmp_path, seeds=(0,)), Stub(), capsys)
    stub = Stub()
    result, _ = run(cells(tmp_path, seeds=(0,), changes=(("ppo.clip", "0.1"),)), stub, capsys)
    assert stub.ran == [] and [why for _, why in result.failed if says(why, "ppo.clip 0.2 0.1")]
    assert len(result.failed) == 2


def test_runs_that_are_longer_than_asked_for_are_listed_with_their_length(tmp_path, capsys):
    run(cells(tmp_path), Stub(), capsys)
    stub = Stub()
    _, said = run(cells(tmp_path, total_steps=STEPS // 2), stub, capsys)
    assert stub.ran == [] and says(said, f"{STEPS:,} {STEPS // 2:,} --total-steps {STEPS} --out")


def test_a_command_that_ends_well_and_leaves_nothing_is_a_failure(tmp_path, capsys):
    result, _ = run(cells(tmp_path, seeds=(0,)), lambda command, log, tick: 0, capsys)
    assert len(result.failed) == 2 and all(says(why, f"finished {cell.log}") for cell, why in result.failed)


def test_the_configuration_of_a_cell_is_what_its_command_trains(tmp_path):
    plan = Plan(
        tmp_path,
        preset="paper",
        changes=(("ppo.clip", "0.1"), ("ppo.num_envs", "64"), ("env.randomization.kp", "30,60")),
    )
    (cell,) = plan.cells(["wide"], [parse_variant("loco-transformer+layers=1")], [4])
    command = cell.train_command()
    trained = train.configuration(train.read(command[len(PROGRAM) + 1 :]))
    assert trained == cell.config
    assert (trained.seed, trained.env.task, trained.network.layers, trained.ppo.clip) == (4, "wide", 1, 0.1)
    assert trained.ppo.total_steps == 15_000_000 and "--total-steps" in command
    assert cell.path == tmp_path / "wide" / "loco-transformer+layers=1" / "seed4"


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(estimate.shutil, "which", lambda name: None)
    monkeypatch.setattr(settings.machine, "cores", lambda: 2)


def test_without_a_run_the_time_is_that_of_compiling_training_and_evaluating(tmp_path, two_cores):
    blind, seeing, again, _ = all_cells = cells(tmp_path)
    known = estimate.paces(all_cells)
    assert (known["state-only", "ppo"].rate, known["loco-transformer", "ppo"].rate) == (8000.0, 800.0)
    # Two evaluations while training and two tasks afterwards, each of 1,000 steps.
    evaluations = 2 * 1000 * estimate.STEP + 2 * (estimate.EVALUATE + 1000 * estimate.STEP)
    assert estimate.seconds_left([blind], known) == pytest.approx(STEPS / 8000 + estimate.START[False] + evaluations)
    assert estimate.seconds_left([blind], known) > 30 * STEPS / 8000  # which was all of it once
    # 32 episodes at once take as long as their samples do, without learning from them.
    evaluations += 2 * (32_000 / (4 * 800) - 1000 * estimate.STEP)
    assert estimate.seconds_left([seeing], known) == pytest.approx(STEPS / 800 + estimate.START[True] + evaluations)
    both = estimate.seconds_left([blind, again], known)
    once = estimate.seconds_left([blind], known)
    assert both == pytest.approx(2 * once - estimate.START[False] + estimate.START_AGAIN)  # what is compiled is kept
    (quiet,) = cells(tmp_path, seeds=(0,), loop=LoopOptions(evaluations=0))[:1]
    assert estimate.seconds_left([quiet], known) == pytest.approx(once - 2 * 1000 * estimate.STEP)


def test_the_time_left_is_that_of_runs_of_the_same_policy(tmp_path, two_cores, monkeypatch):
    all_cells = cells(tmp_path)
    Stub()(all_cells[0].train_command(), all_cells[0].log, lambda: None)
    pace = estimate.paces(all_cells)["state-only", "ppo"]
    assert pace.rate == pytest.approx(8192 / 6.384)  # the second iteration's
    assert pace.start == pytest.approx(10.0 - 6.384 + IMPORTS)  # what the first one took longer
    monkeypatch.setattr(estimate.shutil, "which", lambda name: "/usr/bin/nvidia-smi")
    known = estimate.paces(all_cells)
    assert estimate.seconds_left(all_cells, known) is None  # nothing has run on the GPU with depth
    evaluations = 2 * (estimate.EVALUATE + 1000 * max(estimate.STEP, 32 / (4 * pace.rate)))
    assert estimate.seconds_left([all_cells[0]], known) == pytest.approx(evaluations)
    whole = 2 * 6.384 + pace.start + evaluations
    assert estimate.seconds_left([all_cells[2]], known) == pytest.approx(whole)
    name = all_cells[2].name
    assert estimate.seconds_left([all_cells[2]], known, {name: 8192}, {name}) == pytest.approx(6.384 + evaluations)


def test_the_time_is_also_that_of_a_teacher(tmp_path, two_cores):
    """Four samples of the teacher for each of the policy's: most of the time, and all of the first progress."""
    (cell,) = Plan(tmp_path, total_steps=STEPS).cells(["thin"], [parse_variant("state-only+method=distill")], [0])
    assert cell.teacher_samples == 4 * STEPS
    (pace,) = (known := estimate.paces([cell])).values()
    whole = estimate.seconds_left([cell], known)
    assert whole > 4 * STEPS / pace.teacher.rate + STEPS / pace.rate + 2 * estimate.START[False]
    curves = cell.path / directory.TEACHER / "metrics.csv"
    curves.parent.mkdir(parents=True)
    curves.write_text(f"step,time/seconds\n8192,10.0\n{2 * STEPS},34.0\n")
    assert (cell.done(), cell.teacher_done()) == (0, 2 * STEPS)
    (pace,) = (known := estimate.paces([cell])).values()
    assert pace.teacher.rate == pytest.approx((2 * STEPS - 8192) / 24.0)  # as it was here
    left = estimate.seconds_left([cell], known)
    curves.write_text(f"step,time/seconds\n8192,10.0\n{2 * STEPS},34.0\n{4 * STEPS},66.0\n")
    assert left - estimate.seconds_left([cell], known) == pytest.approx(2 * STEPS / pace.teacher.rate, rel=0.05)


def test_a_command_runs_and_its_output_is_kept(tmp_path):
    log = tmp_path / "deep" / "log"
    assert execute.run_command([sys.executable, "-c", "print('hello'); raise SystemExit(3)"], log, lambda: None) == 3
    assert execute.run_command([sys.executable, "-c", "print('again')"], log, lambda: None) == 0
    assert log.read_text() == "hello\nagain\n"


def test_ctrl_c_lets_the_run_save_and_is_raised_then(tmp_path):
    program = (
        "import signal, time, sys\n"
        "signal.signal(signal.SIGTERM, lambda *_: (print('saved', flush=True), sys.exit(130)))\n"
        "print('ready', flush=True)\ntime.sleep(20)"
    )
    log = tmp_path / "log"

    def interrupt():
        while not log.exists() or "ready" not in log.read_text():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` has it ignored
    threading.Thread(target=interrupt).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            execute.run_command([sys.executable, "-c", program], log, lambda: None)
    finally:
        signal.signal(signal.SIGINT, before)
    assert log.read_text() == "ready\nsaved\n"


BAD = {
    "seeds": (["--seeds", "4-0"], "4-0 0-4"),
    "task": (["--tasks", "thin,thinn"], "task thinn thin"),
    "policy": (["--policies", "state"], "policy state state-only"),
    "eval task": (["--eval-tasks", "wid"], "wid wide"),
    "launcher": (["--launcher", "slurm"], "--launcher slurm local"),
    "launcher's option": (["--gpus-per-cell", "1"], "--gpus-per-cell --launcher ray"),
    "cpus": (["--launcher", "ray", "--cpus-per-cell", "0"], "cpus-per-cell 0 1"),
    "gpus": (["--launcher", "ray", "--gpus-per-cell", "-1"], "gpus-per-cell -1.0 0"),
    "key": (["--set", "ppo.clipp=1"], "ppo.clipp ppo.clip"),
    "preset": (["--preset", "papr"], "preset papr paper"),
    "episodes": (["--episodes", "0"], "episodes 0 1"),
    "steps": (["--total-steps", "0"], "total-steps 0 1"),
    "value": (["--set", "ppo.clip=x"], "ppo.clip x"),
    "two sizes": (["--num-envs", "8", "--set", "ppo.num_envs=16"], "ppo.num_envs twice 8 16"),
    "two values": (["--set", "ppo.clip=0.1", "ppo.clip=0.2"], "ppo.clip twice 0.1 0.2"),
    "two presets": (["--preset", "fast", "--preset=paper"], "--preset twice fast paper"),
    "out": (["--out", "/dev/null"], "/dev/null file"),
    "access": (["--out", "/proc/sweep"], "/proc/sweep"),
}


@pytest.mark.parametrize(("args", "words"), BAD.values(), ids=BAD.keys())
def test_a_mistake_is_named_and_nothing_is_written(args, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", *args]) == 2
    out, err = capsys.readouterr()
    assert out == "" and clear(err) and says(err, words), err
    assert list(tmp_path.iterdir()) == []


def test_the_exit_code_says_whether_something_failed(tmp_path, capsys, monkeypatch):
    local = launch.Local
    args = ["sweep", "--policies", "state-only", "--out", str(tmp_path / "s"), "--total-steps", str(STEPS)]
    for stub, code in ((Stub(fails=["train"]), sweep_cli.FAILED), (Stub(), 0)):
        monkeypatch.setattr(launch, "Local", lambda stub=stub: local(stub))
        assert main(args) == code
    assert f"loco-mjx table {tmp_path / 's'}" in " ".join(capsys.readouterr().out.split())


def test_a_dry_run_shows_and_writes_nothing(tmp_path, capsys):
    assert main(["sweep", "--out", str(tmp_path / "s"), "--seeds", "0-2", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert says(out, "3 0")
    (line,) = [line for line in out.splitlines() if "loco-transformer" in line]
    assert "0,1,2" in line and "0/3" in line and "15,007,744" in line  # 1,832 iterations of 8,192
    assert says(out, "episodes 32")
    assert not (tmp_path / "s").exists()
