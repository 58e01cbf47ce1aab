"""It walks in C MuJoCo, without JAX: commands are tracked, pushes are survived, speed need not be measured."""

import numpy as np
import pytest

from loco_mjx.whole_body.legs import body_of
from tests.known_robots import GO1, GO2
from tests.whole_body.walks import model, walk

NEAR = 0.05  # m/s and rad/s
AFTER = 150  # ticks until it has found its pace


def tracks(done, command):
    speed, _, rate = done.speeds[AFTER:].mean(axis=0)
    assert not done.fell()
    assert speed == pytest.approx(command[0], abs=NEAR) and rate == pytest.approx(command[1], abs=NEAR)
    assert not any(one.facts.unsolved for one in done.ticks)


@pytest.mark.parametrize(
    ("command", "friction", "mass"),
    [((0.4, 0.3), 0.5, 1.2), ((-0.4, 0.3), 1.25, 0.8), ((0.0, -0.3), 1.0, 1.0)],
)
def test_commands_are_tracked(command, friction, mass):
    tracks(walk(model(friction, mass), lambda time: command, 2.5), command)


def test_a_sideways_push_is_recovered_from():
    """60 N for 0.1 s; a second and a half later it walks on as before."""
    done = walk(model(), lambda time: (0.3, 0.0), 2.75, lambda time: 60.0 * (1.0 <= time < 1.1))
    assert not done.fell() and np.abs(done.speeds[200:230, 1]).max() > 0.2
    assert np.abs(done.speeds[-80:].mean(axis=0) - [0.3, 0, 0]).max() < NEAR


def test_it_walks_by_what_its_legs_say():
    tracks(walk(model(0.7), lambda time: (0.3, 0.2), 2.5, by_legs=True), (0.3, 0.2))


@pytest.mark.parametrize("robot", [GO1, GO2], ids=["go1", "go2"])
def test_other_robots_walk(robot):
    tracks(walk(model(robot=robot), lambda time: (0.3, -0.2), 2.5, body=body_of(robot)), (0.3, -0.2))
