"""Work spread over devices is the work of one."""

import jax
import jax.numpy as jp
import numpy as np
import pytest
from jax.sharding import PartitionSpec as P

from loco_mjx.sharding import AXIS, dividing_devices, make_mesh, shard_map


def test_arguments_without_elements_arrive_as_each_device_s_share():
    args = {"x": jp.arange(8.0).reshape(4, 2), "empty": jp.zeros((4, 0, 3), jp.int32)}, jp.zeros((0,))

    def part(tree, alike):
        assert tree["empty"].shape == (4 // jax.device_count(), 0, 3) and tree["empty"].dtype == jp.int32
        assert alike.shape == (0,)
        return tree["x"] + tree["empty"].sum(), tree["empty"]

    x, empty = jax.jit(shard_map(part, make_mesh(), (P(AXIS), P()), P(AXIS)))(*args)
    np.testing.assert_array_equal(x, args[0]["x"])
    assert empty.shape == (4, 0, 3)


def test_no_argument_of_a_device_s_program_is_without_elements_constants_of_loops_included():
    nothing = np.zeros((1, 0), np.int32)

    def part(x, empty):
        grown = jax.lax.while_loop(lambda y: y.sum() < 20, lambda y: y + 1 + jp.take(y, nothing, axis=1).sum(), x)
        return grown + empty.sum()

    run = shard_map(part, make_mesh(), P(AXIS), P(AXIS))
    args = jp.ones((4, 2)), jp.zeros((4, 0))
    (call,) = [eqn for eqn in jax.make_jaxpr(run)(*args).eqns if eqn.primitive.name == "shard_map"]
    assert [var.aval.shape for var in call.invars] == [(4, 2)]  # others crash JAX 0.11.2's compiler on the CPU
    np.testing.assert_array_equal(jax.jit(run)(*args), np.full((4, 2), 5.0))


@pytest.mark.parametrize("size", [1, 3, 4])
def test_the_devices_chosen_divide_the_size_and_no_more_would(size):
    count = len(dividing_devices(size))
    assert size % count == 0
    assert all(size % n for n in range(count + 1, jax.local_device_count() + 1))
