"""No kernel of maps lets JAX choose a type: each is traced as it is compiled for a GPU, under strict promotion."""

import jax
import pytest

from benchmarks.cuda_kernels import KERNELS

SEARCHES = "tuner", "frontier", "edges", "BIT*"  # and what Optax computes
OF_MAPS = [name for name in KERNELS if not name.startswith(SEARCHES)]


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_MAPS)
def test_a_kernel_promotes_no_type(name):
    call = KERNELS[name]()
    with (
        jax.enable_x64(call.is_float64),
        jax.numpy_dtype_promotion("strict"),
    ):
        call.function.trace(*call.arguments, **call.static)
