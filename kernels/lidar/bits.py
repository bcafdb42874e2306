"""Results for many cells as bits of words: bit b of a word holds the cell b bands of rows further north."""

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, UInt


def pack(
    heights_m: Float[Array, "*n Y X"], least_m: Float[Array, "..."], band: int, dtype: DTypeLike = jnp.uint32
) -> UInt[Array, "*n y X"]:
    """Return ``heights_m >= least_m`` as words: bit b of word (i, j) stands for cell (i + b * band, j).

    A word begins in each row but the last ones, from which there is no cell for every bit.
    """
    num_bits = 8 * jnp.dtype(dtype).itemsize
    num_words = heights_m.shape[-2] - (num_bits - 1) * band
    words = jnp.zeros((*heights_m.shape[:-2], num_words, heights_m.shape[-1]), dtype)
    for bit in range(num_bits):
        rows = heights_m[..., bit * band : bit * band + num_words, :]
        words = words | ((rows >= least_m).astype(dtype) << bit)
    return words
