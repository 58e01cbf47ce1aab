"""One run over several processes, usually one per host: how they find each other, and end together.

JAX's multi-process runtime makes one mesh of all processes' devices. Every process runs the same program; the first one
alone writes and speaks (see loco_mjx/run/collectives.py). All of them read the run's directory, which has to lie on a
file system that they share. With one process, which is the rule, everything here does nothing.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jax

from loco_mjx.errors import UserError

CONNECT_SECONDS = 120.0  # for all processes to have started
HEARTBEAT_SECONDS = 60  # after which a host that fell silent counts as dead; a process that ends is noticed at once
SHUTDOWN_SECONDS = 60
_LOST = "another process of this run has ended or cannot be reached; its own last line says why"
_GO_ON = "the last checkpoint is kept: start all of them again to go on"
# Tells of an abort, by which JAX ends a process whose coordinator is gone; it cannot be caught within the process. Its
# threads go on writing until it is dead, which closes the pipe.
_WATCHER = "import sys\nif {} in sys.stdin.buffer.read(): sys.stderr.write({!r})"


@dataclass(frozen=True)
class Place:
    """Which of several processes this one is.

    Attributes:
        coordinator: HOST:PORT of process 0; None: as SLURM says.
        process: 0 to count − 1.
        count: how many there are.
    """

    coordinator: str | None
    process: int
    count: int


def place(
    coordinator: str | None,
    process: int | None,
    count: int | None,
    environment: Mapping[str, str],
) -> Place | None:
    """This process's place: by options, or by SLURM where `srun` has started several tasks; None: it is the only one.

    A batch script's own commands are no such tasks, although SLURM_NTASKS is set there.

    Raises:
        UserError: if some of the options are missing, or do not fit together.
    """
    given = {"--coordinator": coordinator, "--process-id": process, "--num-processes": count}
    missing = [name for name, value in given.items() if value is None]
    if len(missing) == len(given):
        return _slurm(environment)
    if coordinator is None or process is None or count is None:
        raise UserError(f"{' and '.join(missing)} missing; a run over several processes needs {', '.join(given)}")
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 2**16:
        raise UserError(f"coordinator is '{coordinator}'; accepted: HOST:PORT of process 0, e.g. node1:4321")
    if count < 1:
        raise UserError(f"num-processes is {count}; accepted: 1 or more")
    if not 0 <= process < count:
        raise UserError(f"process-id is {process}; accepted: 0 to {count - 1}, one for each of the processes")
    return Place(coordinator, process, count) if count > 1 else None


def _slurm(environment: Mapping[str, str]) -> Place | None:
    try:
        count, process = int(environment["SLURM_STEP_NUM_TASKS"]), int(environment["SLURM_PROCID"])
    except (KeyError, ValueError):
        return None
    return Place(None, process, count) if count > 1 else None


@contextlib.contextmanager
def joined(where: Place | None) -> Iterator[None]:
    """While entered, this process is one of several; to be entered before JAX runs anything.

    An error that one process alone meets ends it at once, without waiting for the others, which then end, too.

    Raises:
        UserError: if the coordinator does not answer.
    """
    if where is None:
        yield
        return
    with _watched():
        try:
            _connect(where, CONNECT_SECONDS)
            with contextlib.redirect_stdout(
                sys.stdout if where.process == 0 else open(os.devnull, "w", errors="replace")
            ):
                yield
            jax.distributed.shutdown()
        except BaseException as error:
            _leave(error)


def _connect(where: Place, seconds: float) -> None:
    """Meets the other processes, within a time limit."""
    if where.coordinator is not None and where.process > 0:
        _await_coordinator(where.coordinator, seconds)
    late = f"{where.count} processes did not all start within {seconds:.0f} s; start each with its own --process-id"
    # Where processes are missing JAX would abort, with a page of addresses.
    timer = threading.Timer(seconds, lambda: _leave(UserError(late)))
    timer.daemon = True
    timer.start()
    more: dict[str, Any] = {} if where.coordinator is None else {"cluster_detection_method": "deactivate"}
    address = where.coordinator or slurm_loopback(os.environ)
    if address is not None and on_loopback(address):
        more["coordinator_bind_address"] = address  # JAX's own default is every interface, and it asks nobody's name
    try:
        jax.distributed.initialize(
            address,
            where.count,
            where.process,
            initialization_timeout=int(seconds) + 30,
            heartbeat_timeout_seconds=HEARTBEAT_SECONDS,
            shutdown_timeout_seconds=SHUTDOWN_SECONDS,
            **more,
        )
    except (RuntimeError, ValueError, OSError) as error:
        raise UserError(f"cannot join the other processes: {str(error).splitlines()[0]}") from error
    finally:
        timer.cancel()


def on_loopback(address: str) -> bool:
    """Whether HOST:PORT is this machine's loopback.

    Names other than `localhost` are not looked up: a host may know its own by a loopback address, and others not.
    """
    host = address.rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def slurm_loopback(environment: Mapping[str, str]) -> str | None:
    """HOST:PORT on the loopback where all tasks of a SLURM step are on one node; None where JAX is to find it."""
    job = environment.get("SLURM_JOB_ID", "")
    if environment.get("SLURM_STEP_NUM_NODES") != "1" or not job.isdigit():
        return None
    return f"127.0.0.1:{2**16 - 2**12 + int(job) % 2**12}"  # the port that JAX itself takes


def _await_coordinator(address: str, seconds: float) -> None:
    host, _, port = address.rpartition(":")
    end, problem = time.monotonic() + seconds, "timed out"
    while time.monotonic() < end:
        try:
            socket.create_connection((host, int(port)), timeout=max(0.1, end - time.monotonic())).close()
            return
        except OSError as error:
            problem = error.strerror or str(error)
            time.sleep(min(0.5, max(0.0, end - time.monotonic())))
    raise UserError(
        f"coordinator {address} did not answer within {seconds:.0f} s ({problem}); is process 0 running there?"
    )


@contextlib.contextmanager
def _watched() -> Iterator[None]:
    """Says one line if this process is aborted."""
    line = f"loco-mjx: {_LOST}; {_GO_ON}\n"
    command = [sys.executable, "-S", "-c", _WATCHER.format(int(signal.SIGABRT), line)]
    watcher = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
    assert watcher.stdin is not None
    os.set_blocking(watcher.stdin.fileno(), False)
    before = signal.signal(signal.SIGABRT, lambda *_: None), signal.set_wakeup_fd(watcher.stdin.fileno())
    try:
        yield
    finally:
        signal.set_wakeup_fd(before[1])
        signal.signal(signal.SIGABRT, before[0])
        watcher.stdin.close()
        watcher.wait()


def _leave(error: BaseException) -> None:
    """Ends this process with the message and code of `loco-mjx`, at once, so that no other process waits for it."""
    code = 1
    if isinstance(error, SystemExit):
        code = error.code if isinstance(error.code, int) else 1
    elif isinstance(error, KeyboardInterrupt):
        code = 130
    elif isinstance(error, UserError) or _is_loss(error):
        text = str(error) if isinstance(error, UserError) else f"{_LOST}; {_GO_ON}"
        sys.stdout.flush()
        _say_last("loco-mjx: " + " ".join(text.split()))
        code = error.code if isinstance(error, UserError) else 2
    else:
        traceback.print_exception(error)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _say_last(line: str) -> None:
    """Writes a line on stderr, and discards what JAX's threads write after it."""
    sys.stderr.flush()
    last = os.dup(2)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    os.write(last, f"{line}\n".encode())


def _is_loss(error: BaseException) -> bool:
    """Whether a collective failed because a process it needs is gone."""
    words = ("Connection closed by peer", "Connection reset by peer", "Gloo", "NCCL", "coordination service")
    return isinstance(error, (ValueError, RuntimeError)) and any(word in str(error) for word in words)
