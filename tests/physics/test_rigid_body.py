"""Mass matrix and bias forces against C MuJoCo's."""

from functools import partial

import jax
import jax.numpy as jp
import mujoco
import numpy as np
import pytest

from loco_mjx import robots
from loco_mjx.physics import block_matrix
from loco_mjx.physics.compiled import compiled
from loco_mjx.physics.links import links
from loco_mjx.physics.mjx import MjxDynamics
from loco_mjx.physics.rigid_body import qM_and_qfrc_bias
from loco_mjx.physics.xla import FusionBarrier
from tests.quick import QUICKLY

pytestmark = pytest.mark.optimized  # compiled as users compile it: it is compared with C MuJoCo

N = 40


def _model(name: str) -> mujoco.MjModel:
    """Of a robot; of the A1 with a payload, sensors on a shank, and armatures, too."""
    spec, model = compiled(robots.get_robot(name.removesuffix("+")))
    if not name.endswith("+"):
        return model
    payload = spec.body("trunk").add_body(name="payload", pos=[0.1, 0.05, 0.12], quat=[0.8, 0.2, 0.5, -0.1])
    payload.mass, payload.inertia, payload.explicitinertial = 3.0, [0.02, 0.03, 0.04], True
    payload.ipos, payload.iquat = [0.02, 0.01, -0.03], [0.5, -0.3, 0.2, 0.7]
    box = spec.body("RL_calf").add_body(name="box", pos=[0.02, 0.01, -0.1], quat=[0.3, 0.2, -0.9, 0.1])
    box.mass, box.inertia, box.explicitinertial = 0.2, [0.001, 0.002, 0.0015], True
    model = spec.compile()
    model.dof_armature[:] = np.linspace(0.01, 0.03, model.nv)
    return model


def _of_c(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, mass: np.ndarray, inertia: np.ndarray):
    matrices, biases = [], []
    nominal = model.body_mass.copy(), model.body_inertia.copy()
    data = mujoco.MjData(model)
    for i in range(N):
        model.body_mass[:], model.body_inertia[:] = nominal[0] * mass[i], nominal[1] * inertia[i]
        data.qpos[:], data.qvel[:] = qpos[:, i], qvel[:, i]
        mujoco.mj_forward(model, data)
        dense = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, dense)
        matrices.append(dense)
        biases.append(data.qfrc_bias.copy())
    return np.stack(matrices, -1), np.stack(biases, -1)


@pytest.mark.parametrize(("name", "by_mjx"), [("a1", False), ("a1+", False), ("go2", False), ("a1", True)])
def test_mass_matrix_and_bias_are_cs(name: str, by_mjx: bool) -> None:
    """At any pose and speed, and whatever the factors on masses and inertias.

    What users have as they compile it; the robot with a payload, which is after the formulas, quickly.
    """
    rng, model = np.random.default_rng(0), _model(name)
    robot = robots.get_robot(name.removesuffix("+"))
    dynamics = MjxDynamics(compiled(robot)[0]) if by_mjx else partial(qM_and_qfrc_bias, robot, links(model))
    quat = rng.normal(size=(4, N))
    qpos = np.concatenate([rng.normal(size=(3, N)), quat / np.linalg.norm(quat, axis=0), rng.uniform(-2, 2, (12, N))])
    qvel = 4.0 * rng.normal(size=(18, N))
    factors = rng.uniform(0.5, 1.5, (2, N))
    dense, bias = _of_c(model, qpos, qvel, *factors)
    arguments = (jp.asarray(x, jp.float32) for x in (qpos, qvel, *factors))
    options = QUICKLY if name.endswith("+") else None
    ours = jax.jit(lambda *args: dynamics(FusionBarrier(), *args), compiler_options=options)(*arguments)
    for block, expected in zip(ours[0], block_matrix.from_dense(jp.asarray(dense)), strict=True):
        np.testing.assert_allclose(block, expected, atol=2e-6)
    np.testing.assert_allclose(block_matrix.join(ours[1]), bias, atol=2e-6 * np.abs(bias).max())
