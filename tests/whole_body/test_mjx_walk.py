"""It walks on MJX's physics as it does in C MuJoCo: the same program steps both, compiled once for four robots."""

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.physics.driven import driven_steps
from loco_mjx.physics.step import initial_state
from loco_mjx.whole_body import walk
from tests.physics import world
from tests.whole_body.walks import BODY, CONFIG, model
from tests.whole_body.walks import walk as walk_c

TICKS, SUBSTEPS, STEPS = 10, 2, 40
CASES = (((0.4, 0.3), 0.5, 1.2), ((-0.4, 0.3), 1.25, 0.8), ((0.3, 0.0), 1.0, 1.0), ((2.0, 0.0), 1.0, 1.0))
NEAR = 0.05  # m/s and rad/s


@pytest.fixture(scope="module")
def walked():
    """Poses (STEPS + 1, 4, 7) every 0.05 s, and facts (STEPS, 4, TICKS) of each case."""
    physics, control = world.physics(), walk.make_controller(CONFIG, BODY)
    run = lambda driven, scene, how: driven_steps(physics, control, driven, scene, how, TICKS, SUBSTEPS)  # noqa: E731
    step, flat = jax.jit(jax.vmap(run)), world.batch([world.scene()])
    start = lambda command: walk.commanded(walk.start(CONFIG, BODY, initial_state(world.standing())), command)  # noqa: E731
    driven = jax.vmap(start)(jp.array([case[0] for case in CASES], jp.float32))
    nominal = [(world.nominal(friction), jp.float32(mass)) for _, friction, mass in CASES]
    how = world.batch([one.replace(mass=mass, inertia=mass) for one, mass in nominal])
    poses, facts = [np.asarray(driven.physics.qpos[:, :7])], []
    for _ in range(STEPS):
        driven, _, said = step(driven, flat, how)
        poses.append(np.asarray(driven.physics.qpos[:, :7]))
        facts.append(jax.tree.map(np.asarray, said))
    return np.stack(poses), jax.tree.map(lambda *x: np.stack(x), *facts)


def test_commands_are_tracked(walked):
    poses, facts = walked
    up = 1 - 2 * (poses[..., 4] ** 2 + poses[..., 5] ** 2)
    assert (up > 0.98).all() and not facts.unsolved.any()
    for case, ((speed, rate), _, _) in enumerate(CASES[:3]):
        w, z = poses[:, case, 3], poses[:, case, 6]
        yaw = np.unwrap(2 * np.arctan2(z, w))
        change, middle = np.diff(poses[:, case, :2], axis=0) / 0.05, 0.5 * (yaw[1:] + yaw[:-1])
        ahead = change[:, 0] * np.cos(middle) + change[:, 1] * np.sin(middle)
        assert ahead[15:].mean() == pytest.approx(speed, abs=NEAR)
        assert (yaw[-1] - yaw[15]) / (0.05 * (STEPS - 15)) == pytest.approx(rate, abs=NEAR)


def test_commands_beyond_the_limits_are_said(walked):
    assert walked[1].clipped[:, 3].all() and not walked[1].clipped[:, :3].any()


def test_c_mujoco_walks_as_far(walked):
    """Two seconds by other contacts, in other arithmetic, through another solver: centimetres apart."""
    theirs = walk_c(model(), lambda time: (0.3, 0.0), STEPS * 0.05).poses[-1]
    np.testing.assert_allclose(walked[0][-1, 2, :2], theirs[:2], atol=0.03)
