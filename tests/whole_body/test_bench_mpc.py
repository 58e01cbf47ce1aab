"""What `bench mpc` measures: programs of a walk, which the libraries solve alike."""

import jax
import numpy as np
import pytest

from loco_mjx.bench import mpc as bench
from loco_mjx.whole_body import library
from tests.known_robots import A1
from tests.whole_body.walks import BODY, CONFIG

pytest.importorskip("osqp")
COUNT = 24


def test_osqp_and_quadprog_find_the_same_forces():
    given = bench.ticks(CONFIG, BODY, A1.default_pose, COUNT)
    libraries, feet = bench.solvers(CONFIG), set()
    assert set(libraries) == {"quadprog", "osqp"}
    for one in range(COUNT):
        program = bench.program(CONFIG, BODY, jax.tree.map(lambda x, i=one: x[i], given))
        dense = library.dense(CONFIG.mpc, program)
        exact, found = libraries["quadprog"](dense)[0], libraries["osqp"](dense)
        assert np.abs(exact - found.x).max() < 1.0
        best = 0.5 * exact @ dense.P @ exact + dense.q @ exact
        assert 0.5 * found.x @ dense.P @ found.x + dense.q @ found.x <= best + 1e-3 * abs(best)
        feet.add(tuple(program.pushes[0].tolist()))
    assert len(feet) == 3  # both pairs, and all four
