"""Signals while Python sees none, as during a compilation: real processes in a function that does not let go."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.refusals import says

CHILD = """
import hashlib, sys, threading, time
from loco_mjx.run.signals import Stop

def tell():
    at_it.wait()
    time.sleep(0.5)  # by now the main thread is in the function
    print("busy", flush=True)

at_it = threading.Event()
threading.Thread(target=tell, daemon=True).start()
with Stop(lambda text: print(text, flush=True), can_leave=sys.argv[1] == "can leave", farewell=lambda: print("bye")):
    at_it.set()
    hashlib.pbkdf2_hmac("sha256", b"word", b"salt", 2_000_000_000)  # half an hour without a look at signals
"""


@pytest.fixture
def busy():
    """Starts a process and waits until it is busy."""
    started = []

    def start(word):
        root = Path(__file__).parents[2]
        child = subprocess.Popen([sys.executable, "-c", CHILD, word], cwd=root, stdout=subprocess.PIPE, text=True)
        started.append(child)
        assert child.stdout.readline() == "busy\n"
        return child

    yield start
    for child in started:
        child.kill()
        child.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_process_with_nothing_to_save_is_ended_at_once(busy, number):
    child = busy("can leave")
    os.kill(child.pid, number)
    said, _ = child.communicate(timeout=120)
    assert child.returncode == 128 + number
    line, bye = said.splitlines()
    assert says(line, "stopped nothing") and bye == "bye"


def test_one_that_has_something_to_save_says_what_it_does_and_ends_when_asked_twice(busy):
    child = busy("cannot")
    os.kill(child.pid, signal.SIGINT)
    assert says(child.stdout.readline(), "stopping iteration")
    os.kill(child.pid, signal.SIGINT)
    said, _ = child.communicate(timeout=120)
    line, bye = said.splitlines()
    assert child.returncode == 130 and says(line, "stopped") and bye == "bye"
