"""No kernel lets JAX choose a type or a rank: each is traced as it is compiled for a GPU, under strict promotion."""

import jax
import pytest

from benchmarks.cuda_kernels import KERNELS

OF_OPTAX = "tuner: descend", "tuner: bootstrap", "tuner: targets, descend"
OURS = [name for name in KERNELS if name not in OF_OPTAX]


@pytest.mark.slow
@pytest.mark.parametrize("name", OURS)
def test_a_kernel_promotes_neither_type_nor_rank(name):
    call = KERNELS[name]()
    with (
        jax.enable_x64(call.is_float64),
        jax.numpy_dtype_promotion("strict"),
        jax.numpy_rank_promotion("raise"),
    ):
        call.function.trace(*call.arguments, **call.static)
