"""Sweeps on a real Ray cluster of two workers, with a stub in place of the commands."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from loco_mjx.cli.main import main
from loco_mjx.compare import launch
from loco_mjx.compare.execute import run_command
from loco_mjx.compare.ray_launcher import Need, OnRay, need, start_here
from loco_mjx.compare.ray_worker import work
from loco_mjx.run import directory
from tests.compare.test_sweep import Stub, cells
from tests.listening import family, listening
from tests.refusals import says

ray = pytest.importorskip("ray")
from ray.cluster_utils import Cluster  # noqa: E402

POLICIES = ("state-only", "loco-transformer")
EIGHT_GPUS, CPUS_ONLY = {"CPU": 64.0, "GPU": 8.0}, {"CPU": 16.0}


@pytest.mark.parametrize(
    ("nodes", "asked", "wanted", "at_once"),
    [
        ([EIGHT_GPUS, CPUS_ONLY], (None, None), Need(1, 1.0), 8),
        ([CPUS_ONLY, {"CPU": 4.0}], (None, None), Need(16, 0.0), 1),
        ([CPUS_ONLY, CPUS_ONLY], (4, None), Need(4, 0.0), 8),
        ([EIGHT_GPUS], (16, 0.5), Need(16, 0.5), 4),
        ([EIGHT_GPUS], (None, 0.0), Need(64, 0.0), 1),
        ([CPUS_ONLY], (None, 1.0), Need(1, 1.0), 0),
        ([{"CPU": 0.0}], (None, None), Need(1, 0.0), 0),
    ],
)
def test_what_a_cell_takes_and_how_many_run_at_once(nodes, asked, wanted, at_once):
    assert need(nodes, *asked) == wanted
    assert sum(wanted.fits(node) for node in nodes) == at_once


@dataclass(frozen=True)
class Worker:
    """A stub that notes which node ran what, and may hold what comes to a node, or kill its worker."""

    notes: Path
    fails: tuple[str, ...] = ()
    holds: str | None = None  # node whose first run goes on until it is told to save
    dies: str | None = None

    def __call__(self, command, log, tick):
        words, node = " ".join(command), ray.get_runtime_context().get_node_id()
        (self.notes / str(time.monotonic_ns())).write_text(f"{node} {words}")
        if self.dies and self.dies in words:
            os._exit(1)
        if node == self.holds:
            return run_command([sys.executable, "-c", HELD, str(self.notes / "held")], log, tick)
        return Stub(fails=self.fails)(command, log, tick)

    def ran(self, words):
        """The nodes that ran commands with these words, in order."""
        notes = sorted(path for path in self.notes.iterdir() if path.name.isdigit())
        return [path.read_text().split()[0] for path in notes if words in path.read_text()]


HELD = """
import os, pathlib, signal, sys, time
held = pathlib.Path(sys.argv[1])
signal.signal(signal.SIGTERM, lambda *_: (held.with_name("saved").touch(), sys.exit(143)))
held.with_name("starting").write_text(str(os.getpid()))
held.with_name("starting").rename(held)
time.sleep(100)
"""


@pytest.fixture(scope="module")
def cluster():
    """Two workers with a CPU each."""
    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    head = {"include_dashboard": False, "_system_config": {"worker_niceness": 0}}  # Ray's 15 starves beside other tests
    made = Cluster(initialize_head=True, head_node_args=node | head)
    made.other = made.add_node(**node)
    yield made
    made.shutdown()


def sweep(cluster, cells, capsys, worker, **options):
    result = launch.sweep(cells, Console(width=200), OnRay(cluster.address, run=worker, **options))
    return result, capsys.readouterr()


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def notes(tmp_path, name):
    (tmp_path / name).mkdir()
    return tmp_path / name


def test_ctrl_c_lets_runs_save(cluster, tmp_path, capsys):
    worker = Worker(notes(tmp_path, "notes"), holds=cluster.other.node_id)

    def interrupt():
        until((worker.notes / "held").exists)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` has it ignored
    threading.Thread(target=interrupt).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            sweep(cluster, cells(tmp_path / "s", eval_tasks=("thin",)), capsys, worker)
    finally:
        signal.signal(signal.SIGINT, before)
    assert (worker.notes / "saved").exists()
    assert not ray.is_initialized()


def test_a_worker_that_is_killed_and_cells_that_fail(cluster, tmp_path, capsys):
    """A cell whose node is killed goes on on the other, one always fails, one kills every worker it gets."""
    victim, killed = cluster.other, notes(tmp_path, "notes")
    worker = Worker(killed, ("state-only --seed 1",), victim.node_id, dies="loco-transformer --seed 1")

    def kill():
        until((worker.notes / "held").exists)
        cluster.remove_node(victim, allow_graceful=False)

    thread = threading.Thread(target=kill)
    thread.start()
    found = cells(tmp_path / "s", eval_tasks=("thin",))
    result, said = sweep(cluster, found, capsys, worker, retries=1)
    thread.join()
    assert [cell.name for cell in found if cell.finished()] == [f"thin/{name}/seed0" for name in POLICIES]
    assert {cell.name for cell in result.ran} == {f"thin/{name}/seed0" for name in POLICIES}
    problems = {cell.name: why for cell, why in result.failed}
    assert says(problems["thin/state-only/seed1"], "train 2 disk full")  # the exit code, and what it printed last
    assert says(problems["thin/loco-transformer/seed1"], "worker 2")
    assert (len(result.ran), len(result.skipped), len(result.failed)) == (2, 0, 2) and says(said.out, "1 CPU 2 failed")
    assert said.err == ""
    nodes = [worker.ran(f"train --task thin --policy {name} --seed 0") for name in POLICIES]
    assert [victim.node_id, cluster.head_node.node_id] in nodes
    pid = int((worker.notes / "held").read_text())
    until(lambda: not Path(f"/proc/{pid}").exists())  # nothing trains on by itself on the node that was lost

    again = Worker(notes(tmp_path, "again"))
    result, _ = sweep(cluster, found, capsys, again)
    assert len(result.skipped) == len(result.ran) == 2 and not result.failed and again.ran("/seed0") == []


def test_a_cluster_started_for_a_sweep_listens_to_this_machine_alone():
    before = listening(os.getpid())  # the two workers of the other tests
    start_here(ray, include_dashboard=False, object_store_memory=80_000_000, log_to_driver=False, num_cpus=1)
    try:
        worker = ray.get(ray.remote(lambda: os.getpid()).remote())
        found = [one for one in listening(os.getpid()) if one not in before]
        assert worker in family(os.getpid()) and len(listening(worker)) == 1
        assert len(found) > 4 and [one for one in found if not one.startswith("127.0.0.1:")] == []
    finally:
        ray.shutdown()


def test_a_cell_that_no_node_holds(cluster, tmp_path, capsys):
    said = refused(capsys, tmp_path, "--ray-address", cluster.address, "--gpus-per-cell", "1")
    assert says(said, "1 CPU GPU 0 --cpus-per-cell --gpus-per-cell"), said


def refused(capsys, tmp_path, *words):
    args = ["sweep", "--launcher", "ray", "--out", str(tmp_path / "s"), *words]
    assert main(args) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and not (tmp_path / "s").exists(), (out, err)
    return err


def test_no_cluster_at_the_address(tmp_path, capsys):
    assert says(refused(capsys, tmp_path, "--ray-address", "127.0.0.1:1"), "127.0.0.1:1 --ray-address")
    for address in ("nowhere", "host:99999", ":6379", "ray://host:port"):
        assert says(refused(capsys, tmp_path, "--ray-address", address), f"--ray-address '{address}' HOST:PORT")


def test_ray_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert says(refused(capsys, tmp_path), "pip install 'loco-mjx[cluster]'")


def test_a_node_that_does_not_see_the_directory(tmp_path):
    (cell, *_) = cells(tmp_path / "s")
    said = work(cell, lambda *_: pytest.fail("it ran"))
    assert says(said, f"{cell.path.parent} --out")


def test_a_run_that_is_still_saving_is_waited_for(tmp_path):
    (cell, *_) = cells(tmp_path / "s", eval_tasks=("thin",))
    order = []
    with directory.claim(cell.path):
        thread = threading.Thread(target=lambda: work(cell, lambda *_: order.append("ran") or 1))
        thread.start()
        time.sleep(0.5)
        order.append("saved")
    thread.join()
    assert order == ["saved", "ran"]


def test_what_a_killed_process_started_is_told_to_save(tmp_path):
    """Nothing of ours runs any more in it; the kernel does it."""
    held = tmp_path / "held"
    program = "import pathlib, sys; from loco_mjx.compare.execute import run_command as run; "
    program += f"run([sys.executable, '-c', {HELD!r}, {str(held)!r}], pathlib.Path({str(tmp_path / 'log')!r}), None)"
    process = subprocess.Popen([sys.executable, "-c", program])
    until(held.exists)
    process.kill()
    process.wait()
    until((tmp_path / "saved").exists, 10.0)
