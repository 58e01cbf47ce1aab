"""Runs a sweep's cells on a Ray cluster: a cell is a task, retried on another worker when its own dies.

Every node needs this package and the sweep's directory at the same path: a run is resumed from the checkpoint that it
left there, and progress is read from its curves.
"""

from __future__ import annotations

import contextlib
import importlib.util
import ipaddress
import logging
import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from loco_mjx.compare.cells import Cell
from loco_mjx.compare.execute import TICK_SECONDS, Runner, run_command
from loco_mjx.compare.launch import Ended
from loco_mjx.compare.progress import Progress
from loco_mjx.compare.ray_worker import SAVE_SECONDS, work
from loco_mjx.errors import UserError

AUTO = "auto"  # the cluster that runs on this machine
CLUSTERS = "ENABLE_RAY_CLUSTER"  # Ray's constant: whether nodes other than this one are ever to join
CONNECT_SECONDS = 10.0
RETRIES = 3
OBJECT_STORE_BYTES = 100_000_000  # of a cluster started here; cells are paths, Ray would take a third of the memory


@dataclass(frozen=True)
class Need:
    """What Ray sets aside for one cell: CPUs and GPUs."""

    cpus: int
    gpus: float

    def fits(self, node: Mapping[str, float]) -> int:
        """How many cells a node runs at once."""
        places = node.get("CPU", 0.0) // self.cpus
        return int(min(places, node.get("GPU", 0.0) // self.gpus) if self.gpus else places)

    def __str__(self) -> str:
        return f"{self.cpus:g} CPU" + (f" and {self.gpus:g} GPU" if self.gpus else "")


@dataclass(frozen=True)
class OnRay:
    """A Ray cluster.

    Attributes:
        address: HOST:PORT or auto; None: $RAY_ADDRESS, else this machine's cluster, else one started for the sweep.
        cpus: set aside for a cell; None: see `need`.
        gpus: the same.
        retries: after its worker died.
        run: runs one command.
    """

    address: str | None = None
    cpus: int | None = None
    gpus: float | None = None
    retries: int = RETRIES
    run: Runner = run_command

    def __post_init__(self) -> None:
        """Checks what can be without a cluster.

        Raises:
            UserError: if Ray is missing or a size is none.
        """
        if importlib.util.find_spec("ray") is None:
            raise UserError("--launcher ray needs Ray; pip install 'loco-mjx[cluster]'")
        if self.cpus is not None and self.cpus < 1:
            raise UserError(f"cpus-per-cell is {self.cpus}; accepted: 1 or more")
        if self.gpus is not None and self.gpus < 0:
            raise UserError(f"gpus-per-cell is {self.gpus:g}; accepted: 0 or more")

    @contextlib.contextmanager
    def ready(self) -> Iterator[None]:
        """Connected to the cluster.

        Raises:
            UserError: if there is none at the address, or none of its nodes can hold a cell.
        """
        import ray

        self._connect(ray)
        try:
            nodes = _nodes(ray)
            wanted = need(nodes, self.cpus, self.gpus)
            if not any(wanted.fits(node) for node in nodes):
                has = ", ".join(sorted({f"{node.get('CPU', 0):g} CPU, {node.get('GPU', 0):g} GPU" for node in nodes}))
                raise UserError(
                    f"no node of the Ray cluster holds a cell of {wanted} (its nodes: {has or 'none'}); "
                    "choose --cpus-per-cell and --gpus-per-cell"
                )
            yield
        finally:
            ray.shutdown()

    def launch(self, cells: Sequence[Cell], progress: Progress, ended: Ended) -> None:
        """Runs cells as tasks, the first ones first; as many at once as the nodes hold."""
        import ray

        nodes = _nodes(ray)
        wanted = need(nodes, self.cpus, self.gpus)
        at_once = sum(wanted.fits(node) for node in nodes)
        where = ray.get_runtime_context().gcs_address
        progress.say(f"Ray at {where}, nodes: {len(nodes)}; a cell takes {wanted}, {at_once} run at once")
        task = ray.remote(num_cpus=wanted.cpus, num_gpus=wanted.gpus, max_retries=self.retries)(work)
        tasks = {task.remote(_absolute(cell), self.run): cell for cell in cells}
        try:
            while tasks:
                left = list(tasks)
                found, _ = ray.wait(left, timeout=TICK_SECONDS)
                for one in found:
                    ended(tasks[one], self._problem(ray, one))
                    cell = tasks.pop(one)
                    text = f"{cell.name}: ended, {len(cells) - len(tasks)} of {len(cells)}; time left: "
                    progress.say(text + progress.time_left([*tasks.values()], at_once))
                progress.tick([*tasks.values()])
        except BaseException:
            _cancel(ray, list(tasks))
            raise

    def _connect(self, ray: Any) -> None:
        """Connects, or starts a cluster where no address is given and none runs."""
        quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
        given = self.address or os.environ.get("RAY_ADDRESS")
        if given and given != AUTO:
            _check_address(given)
        try:
            ray.init(given or AUTO, **quiet)
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            if given:
                raise UserError(f"no Ray cluster at {given}: {_line(error)}; give --ray-address HOST:PORT") from error
            start_here(ray, include_dashboard=False, object_store_memory=OBJECT_STORE_BYTES, **quiet)

    def _problem(self, ray: Any, task: Any) -> str | None:
        """What went wrong with a task that ended, or None."""
        try:
            return ray.get(task)
        except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError):
            return f"its worker died {self.retries + 1} times; the checkpoints remain, run the sweep again"
        except ray.exceptions.RayError as error:
            return f"Ray: {_line(error)}"


def start_here(ray: Any, **options: Any) -> None:
    """Starts a cluster on this machine that listens on its loopback alone: whoever reaches Ray's ports runs anything.

    Ray on Linux turns a loopback address into one that others reach, on macOS and Windows it does the reverse; what
    decides it there is a constant, read while a cluster starts.

    Raises:
        UserError: if this Ray would listen to others all the same.
    """
    from ray._private import ray_constants

    before = getattr(ray_constants, CLUSTERS, True)
    setattr(ray_constants, CLUSTERS, False)
    try:
        ray.init("local", **options)
    finally:
        setattr(ray_constants, CLUSTERS, before)
    host = ray.get_runtime_context().gcs_address.rpartition(":")[0].strip("[]")
    if not ipaddress.ip_address(host).is_loopback:
        ray.shutdown()
        raise UserError(
            f"Ray {ray.__version__} would listen on {host}; start a cluster as you want it: `ray start --head`"
        )


def need(nodes: Sequence[Mapping[str, float]], cpus: int | None, gpus: float | None) -> Need:
    """What a cell takes: what was asked for, else a GPU where there are any, else the whole of the largest node.

    A run uses all the CPUs it finds, so that two on one node would be in each other's way; on a GPU one CPU does.

    Args:
        nodes: resources of each.
        cpus: asked for.
        gpus: asked for.
    """
    if gpus is None:
        gpus = 1.0 if any(node.get("GPU", 0.0) >= 1 for node in nodes) else 0.0
    if cpus is None:
        cpus = 1 if gpus else max([1, *(int(node.get("CPU", 0.0)) for node in nodes)])
    return Need(cpus, gpus)


def _check_address(address: str) -> None:
    """Refuses an address where nothing listens: Ray itself would wait for minutes and then end the program.

    Raises:
        UserError: saying so.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or int(port) >= 2**16:
        raise UserError(f"--ray-address is '{address}'; accepted: HOST:PORT of the cluster's head, or auto")
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except OSError as error:
        raise UserError(f"no Ray cluster at {address}: {_line(error)}; give --ray-address HOST:PORT") from error


def _nodes(ray: Any) -> list[Mapping[str, float]]:
    """The resources of every node that is up."""
    return [node["Resources"] for node in ray.nodes() if node["Alive"]]


def _absolute(cell: Cell) -> Cell:
    """The cell with a path that means the same in any process."""
    return replace(cell, path=cell.path.absolute())


def _cancel(ray: Any, tasks: list[Any]) -> None:
    """Interrupts tasks and waits for their runs to save; a second Ctrl-C does not wait."""
    with contextlib.suppress(KeyboardInterrupt):
        for task in tasks:
            ray.cancel(task)
        ray.wait(tasks, num_returns=len(tasks), timeout=SAVE_SECONDS) if tasks else None


def _line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
