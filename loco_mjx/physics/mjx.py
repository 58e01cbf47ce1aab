"""Mass matrix and bias forces by MJX, MuJoCo's own library for JAX: the other way to what rigid_body.py computes.

Importing MJX takes about a second, so that this module is imported only where it is asked for.
"""

from __future__ import annotations

import contextlib
import io
from typing import Any

import jax
import mujoco

from loco_mjx.physics import block_matrix
from loco_mjx.physics.block_matrix import BlockMatrix, DofVector
from loco_mjx.physics.xla import FusionBarrier

_said = io.StringIO()
with contextlib.redirect_stdout(_said):  # it tells of a renderer which is not installed and not used here
    from mujoco import mjx
for _line in _said.getvalue().splitlines():
    if not _line.startswith("Failed to import"):
        print(_line)


class MjxDynamics:
    """What :func:`rigid_body.qM_and_qfrc_bias` computes, of any robot that MuJoCo has compiled."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        """Of a robot by itself; its geoms, and all else without mass, are taken out of `spec`."""
        for item in (*spec.sensors, *spec.geoms, *spec.sites, *spec.cameras, *spec.lights):
            spec.delete(item)
        bare = spec.compile()
        bare.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        with jax.ensure_compile_time_eval():  # so that an environment may be made inside of a function that JAX traces
            self._model, self._data = mjx.put_model(bare, impl="jax"), mjx.make_data(bare, impl="jax")

    def __call__(
        self, barrier: FusionBarrier, qpos: jax.Array, qvel: jax.Array, mass: jax.Array, inertia: jax.Array
    ) -> tuple[BlockMatrix, DofVector]:
        """Arrays have the environments on their last axis."""
        qM, qfrc_bias = barrier(jax.vmap(self._one, in_axes=-1, out_axes=-1), qpos, qvel, mass, inertia)
        return barrier(block_matrix.from_dense, qM), block_matrix.split(qfrc_bias)

    def _one(self, qpos: jax.Array, qvel: jax.Array, mass: jax.Array, inertia: jax.Array) -> tuple[Any, Any]:
        m: Any = self._model.replace(
            body_mass=self._model.body_mass * mass, body_inertia=self._model.body_inertia * inertia
        )
        d: Any = self._data.replace(qpos=qpos, qvel=qvel)
        d = mjx.crb(m, mjx.com_pos(m, mjx.kinematics(m, d)))
        d = mjx.rne(m, mjx.com_vel(m, d))
        return mjx.full_m(m, d), d.qfrc_bias
