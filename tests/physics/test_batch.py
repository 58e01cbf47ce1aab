"""A function of a batch as one of a single environment: what its vmaps are, and what is declared is what comes."""

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.physics.batch import together
from tests.refusals import refusal

RESULT = {"sum": jax.ShapeDtypeStruct((), jp.float32), "rows": jax.ShapeDtypeStruct((), jp.int32)}


def many(x, y):
    """Sums of (N, 3), and how many rows came together."""
    return {"sum": jp.sum(x * y, axis=1), "rows": jp.full(x.shape[:1], x.shape[0], jp.int32)}


def test_vmaps_of_one_are_the_batch_whatever_is_mapped():
    one = together(many, RESULT)
    x, y = np.arange(30, dtype=np.float32).reshape(2, 5, 3), np.arange(15, dtype=np.float32).reshape(5, 3)
    np.testing.assert_array_equal(together(many)(x[0, 0], y[1])["sum"], x[0, 0] @ y[1])
    for compiled in (lambda f: f, jax.jit):
        assert compiled(one)(x[0, 0], y[1]) == {"sum": x[0, 0] @ y[1], "rows": 1}
        nested = compiled(jax.vmap(jax.vmap(one), (0, None)))(x, y)
        np.testing.assert_array_equal(nested["sum"], (x * y).sum(-1))
        np.testing.assert_array_equal(nested["rows"], np.full((2, 5), 10))
        last = compiled(jax.vmap(one, (1, None), 0))(x[0].T, y[0])
        np.testing.assert_array_equal(last["sum"], x[0] @ y[0])


@pytest.mark.parametrize(
    "wrong",
    [
        RESULT | {"sum": jax.ShapeDtypeStruct((3,), jp.float32)},
        RESULT | {"rows": jax.ShapeDtypeStruct((), jp.float32)},
        {"sum": RESULT["sum"]},
    ],
)
def test_a_result_that_is_not_what_was_declared_is_refused(wrong):
    with refusal("declared", TypeError):
        jax.jit(together(many, wrong))(jp.ones(3), jp.ones(3))
