"""One run over several real processes on loopback: the same curves as one process, and all end together."""

from __future__ import annotations

import contextlib
import csv
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.run import checkpoint, multihost, start
from tests.listening import listening
from tests.refusals import refusal
from tests.run.tiny import tiny_trainer

ROOT = Path(__file__).parents[2]
WORDS = [
    *("train", "--policy", "state-only", "--preset", "paper", "--num-envs", "4", "--ppo.unroll", "8"),
    *("--ppo.minibatch", "16", "--ppo.epochs", "2", "--ppo.pool-size", "4", "--ppo.pool-refresh", "2"),
    *("--network.state-only-hidden", "8", "8", "--ppo.learning-rate-decay", "False", "--env.horizon", "10"),
]
QUIET = [*WORDS, "--evaluations", "0"]
LIMIT = 240  # s, for what takes a few on a machine with nothing else to do


@pytest.fixture
def launch():
    """Starts processes, and ends those that a test leaves."""
    started = []

    def start_one(words, cores=1, seconds=LIMIT, **environment):
        command = [sys.executable, "-m", "tests.run.child", str(cores), str(seconds), *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        started.append(subprocess.Popen(command, cwd=ROOT, env=os.environ | environment, **pipes))
        return started[-1]

    yield start_one
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        process.communicate()


def _address():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{found.getsockname()[1]}"


def _pair(launch, words, **options):
    address = _address()
    join = ["--coordinator", address, "--num-processes", "2", "--process-id"]
    return [launch([*words, *join, str(i)], **options) for i in range(2)]


def _slurm_pair(launch, words):
    """Two tasks of a job, as `srun` tells them what they are; JAX finds a port by the job's number."""
    job = {
        "SLURM_JOB_ID": str(os.getpid()),
        "SLURM_STEP_NODELIST": "localhost",
        "SLURM_NTASKS": "2",
        "SLURM_STEP_NUM_TASKS": "2",
        "SLURM_STEP_NUM_NODES": "1",
    }
    return [launch(words, **job, SLURM_PROCID=str(i), SLURM_LOCALID=str(i)) for i in range(2)]


def _end(process):
    out, err = process.communicate(timeout=LIMIT)
    return process.returncode, out, err


def _rows(folder):
    with (folder / "metrics.csv").open() as file:
        return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in csv.DictReader(file)]


def _await_rows(folder, count):
    end = time.monotonic() + LIMIT
    while not (folder / "metrics.csv").exists() or len(_rows(folder)) < count:
        assert time.monotonic() < end
        time.sleep(0.05)


def _files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_processes_learn_what_one_does_and_one_goes_on_from_their_checkpoint(launch, tmp_path, monkeypatch, capsys):
    both = [*WORDS, "--evaluations", "1", "--total-steps", "96"]
    pair = _slurm_pair(launch, [*both, "--out", str(tmp_path / "two")])
    first, second = (_end(process) for process in pair)
    assert first[0] == second[0] == 0, (first, second)
    assert "finished: 96 samples" in first[1] and "2 × cpu" in first[1]
    assert "samples" not in second[1]  # one of them speaks
    single = _end(launch([*both, "--out", str(tmp_path / "one")], cores=2))
    assert single[0] == 0, single
    found, wanted = _rows(tmp_path / "two"), _rows(tmp_path / "one")
    assert [row["step"] for row in found] == ["32", "64", "96"] and found[-1]["eval/distance"] and len(wanted) == 3
    for row, expected in zip(found, wanted, strict=True):
        assert row.keys() == expected.keys()
        for name, value in expected.items():
            assert bool(value) == bool(row[name]), name
            if value:
                np.testing.assert_allclose(float(row[name]), float(value), rtol=1e-5, atol=1e-7, err_msg=name)

    monkeypatch.setattr(start, "build", tiny_trainer)
    assert main([*QUIET, "--total-steps", "128", "--out", str(tmp_path / "two")]) == 0
    assert "resuming at 96 samples" in capsys.readouterr().out
    assert main([*QUIET, "--total-steps", "128", "--out", str(tmp_path / "one")]) == 0
    last, expected = _rows(tmp_path / "two")[-1], _rows(tmp_path / "one")[-1]
    assert last["step"] == "128" and last["loss/total"] == expected["loss/total"]


def test_a_signal_to_any_process_stops_all_at_the_same_iteration_and_a_dead_one_ends_the_others(launch, tmp_path):
    words = [*QUIET, "--total-steps", "100000000", "--checkpoint-minutes", "0", "--out", str(tmp_path)]
    pair = _pair(launch, words)
    _await_rows(tmp_path, 2)
    coordinator = pair[0].args[pair[0].args.index("--coordinator") + 1]
    port = coordinator.rpartition(":")[2]  # the collectives' own sockets are where the host's name is
    assert [one for one in listening(pair[0].pid) if one.endswith(f":{port}")] == [coordinator]
    pair[1].send_signal(signal.SIGTERM)
    first, second = (_end(process) for process in pair)
    assert first[0] == second[0] == 128 + signal.SIGTERM, (first, second)
    saved = checkpoint.steps(tmp_path)[0]
    assert f"saved at {saved:,} samples" in first[1] and int(_rows(tmp_path)[-1]["step"]) == saved

    pair = _pair(launch, words)  # which go on together
    _await_rows(tmp_path, saved // 32 + 2)
    pair[1].kill()
    code, out, err = _end(pair[0])
    assert code == 2 and f"resuming at {saved:,} samples" in out
    assert "another process of this run has ended" in err.strip().splitlines()[-1]
    last = checkpoint.steps(tmp_path)[0]
    assert last > saved and checkpoint.damage(checkpoint.path_of(tmp_path, last), checkpoint.STATE) is None


def test_the_death_of_the_first_process_ends_the_others_with_a_clear_last_line(launch, tmp_path):
    pair = _pair(launch, [*QUIET, "--total-steps", "100000000", "--out", str(tmp_path)])
    _await_rows(tmp_path, 2)
    pair[0].kill()
    code, _, err = _end(pair[1])
    assert code in (2, -signal.SIGABRT)  # JAX's own client may abort before the collective fails
    assert "another process of this run has ended" in err.strip().splitlines()[-1]


def test_what_processes_cannot_do_together_all_refuse_and_nothing_is_written(launch, tmp_path):
    out = ["--total-steps", "96", "--out", str(tmp_path / "run")]
    odd = [{"--num-envs": "3", "--ppo.minibatch": "8"}.get(QUIET[i - 1], word) for i, word in enumerate(QUIET)]
    for code, _, err in map(_end, _pair(launch, [*odd, *out])):
        assert code == 2 and "num_envs 3 does not divide over 2 devices" in err.strip().splitlines()[-1]
    assert not (tmp_path / "run").exists()


def test_waiting_for_processes_that_do_not_come_has_an_end(launch, tmp_path):
    words = [*QUIET, "--total-steps", "96", "--out", str(tmp_path / "run"), "--num-processes", "2", "--process-id"]
    said = ("did not all start within 2 s", "did not answer within 2 s")
    waiting = [launch([*words, str(i), "--coordinator", _address()], seconds=2) for i in range(2)]
    for process, what in zip(waiting, said, strict=True):
        code, _, err = _end(process)
        assert code == 2 and what in err.strip().splitlines()[-1], err
    assert not (tmp_path / "run").exists()


REFUSED = {
    "half": (("node1:1", None, None), "--process-id --num-processes"),
    "no coordinator": ((None, 0, 2), "--coordinator"),
    "no port": (("node1", 0, 2), "HOST:PORT"),
    "port": (("node1:99999", 0, 2), "HOST:PORT"),
    "too large": (("node1:1", 2, 2), "process-id 2 0 1"),
    "negative": (("node1:1", -1, 2), "process-id -1"),
    "none": (("node1:1", 0, 0), "num-processes 0"),
}


@pytest.mark.parametrize(("given", "named"), REFUSED.values(), ids=REFUSED.keys())
def test_places_that_mean_nothing_are_refused(given, named):
    with refusal(named):
        multihost.place(*given, {})


def test_only_a_task_of_several_that_srun_started_is_one_of_several():
    batch_script = {"SLURM_JOB_ID": "7", "SLURM_NTASKS": "2", "SLURM_PROCID": "0"}
    assert multihost.place(None, None, None, batch_script) is None
    assert multihost.place(None, None, None, batch_script | {"SLURM_STEP_NUM_TASKS": "1"}) is None
    task = batch_script | {"SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": "1"}
    assert multihost.place(None, None, None, task) == multihost.Place(None, 1, 2)
    assert multihost.place("here:1", 0, 3, task) == multihost.Place("here:1", 0, 3)


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        ("localhost:1", True),
        ("127.0.0.1:1", True),
        ("127.3.2.1:1", True),
        ("[::1]:1", True),
        ("0.0.0.0:1", False),
        ("10.0.0.1:1", False),
        ("node1:1", False),
    ],
)
def test_what_only_this_machine_reaches(address, loopback):
    assert multihost.on_loopback(address) is loopback


def test_a_step_of_slurm_on_one_node_stays_on_it():
    step = {"SLURM_JOB_ID": "5000", "SLURM_STEP_NUM_NODES": "1"}
    assert multihost.slurm_loopback(step) == "127.0.0.1:62344"
    assert multihost.slurm_loopback(step | {"SLURM_STEP_NUM_NODES": "2"}) is None
    assert multihost.slurm_loopback({"SLURM_JOB_ID": "5000"}) is None
