"""Sums and products as two floats against exact fractions."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.kernels.two_floats import product_and_rest, sum_and_rest


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_two_floats_hold_a_sum_and_a_product_exactly(dtype):
    rng = np.random.default_rng(0)
    with jax.enable_x64(dtype == np.float64):
        a, b = (jnp.asarray(rng.normal(size=300) * 10.0 ** rng.integers(-6, 3, 300), dtype) for _ in range(2))
        for of_two, exact in ((sum_and_rest, Fraction.__add__), (product_and_rest, Fraction.__mul__)):
            high, rest = jax.jit(of_two)(a, b)
            assert high.dtype == rest.dtype == dtype
            parts = zip(*(np.asarray(values, float) for values in (high, rest, a, b)), strict=True)
            for one, other, x, y in parts:
                assert Fraction(one) + Fraction(other) == exact(Fraction(x), Fraction(y))
            assert np.any(rest)
