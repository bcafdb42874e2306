"""Lidar scan returns shaped for a GPU: the rays of all azimuths and cells together, a few steps a turn.

The rules are those of `jaxurban.kernels.lidar.flat` and, over terrain, of `jaxurban.kernels.lidar.terrain_cpu`, and so
are the counts, bit for bit. Every loop has a known number of turns, a few steps of a ray each, so that nothing waits
for a result: a GPU starts a few kernels a turn. What the rays have met stays in memory between turns: over flat ground
a bit for each cell and azimuth, over terrain a byte. A CPU is many times slower with it than with its own forms.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, UInt

WORD_BITS = 32
STEPS_AT_ONCE = 4  # of rays, in one turn of the loop: what they have met is read and written once


def pack(
    heights_m: Float[Array, "*n Y X"], least_m: Float[Array, "..."], band: int, dtype: DTypeLike = jnp.uint32
) -> UInt[Array, "*n y X"]:
    """Return ``heights_m >= least_m`` as words: bit b of word (i, j) stands for cell (i + b * band, j), b bands north.

    A word begins in each row but the last ones, from which there is no cell for every bit.
    """
    num_bits = 8 * jnp.dtype(dtype).itemsize
    num_words = heights_m.shape[-2] - (num_bits - 1) * band
    words = jnp.zeros((*heights_m.shape[:-2], num_words, heights_m.shape[-1]), dtype)
    for bit in range(num_bits):
        rows = heights_m[..., bit * band : bit * band + num_words, :]
        words = words | ((rows >= least_m).astype(dtype) << bit)
    return words


@partial(jax.jit, static_argnames="halo")
def count_returns_by_steps(
    roof_m: Float[Array, "P Y+2H X+2H"], thresholds_m: Float[Array, "A N"], starts: Int[Array, "K N 3"], *, halo: int
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32.

    Args:
      roof_m: roof heights, 0 without a building, as `jaxurban.kernels.lidar.flat.phases`.
      thresholds_m: from `jaxurban.kernels.lidar.flat.flat_thresholds`, rounded up to the type of ``roof_m``.
      starts: from `jaxurban.kernels.lidar.flat.phase_starts`.
      halo: H, cells beyond the receivers.
    """
    rows, cols = (size - 2 * halo for size in roof_m.shape[1:])
    band = -(-rows // WORD_BITS)
    padded_m = jnp.pad(roof_m, ((0, 0), (0, WORD_BITS * band - rows), (0, 0)))

    def count_at(threshold_m: jax.Array) -> jax.Array:
        def step(returned, of_step):
            threshold, start = of_step
            return returned | _looks(pack(padded_m, threshold, band), start, (band, cols)), None

        none = jnp.zeros((len(starts), band, cols), jnp.uint32)
        returned, _ = lax.scan(step, none, (threshold_m, starts.swapaxes(0, 1)), unroll=STEPS_AT_ONCE)
        bits = jnp.arange(WORD_BITS, dtype=jnp.uint32)[:, None, None]
        return jnp.sum((returned[:, None] >> bits) & 1, axis=0, dtype=jnp.int32).reshape(-1, cols)[:rows]

    return lax.map(count_at, thresholds_m)


@partial(jax.jit, static_argnames=("halo", "receiver_phase"))
def count_returns_on_terrain_by_steps(
    roof_m: Float[Array, "P Y+2H X+2H"],
    terrain_m: Float[Array, "P Y+2H X+2H"],
    lowest_m: Float[Array, "A N B"],
    starts: Int[Array, "K N 3"],
    *,
    halo: int,
    receiver_phase: int = 0,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, Y, X]`` int32.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `jaxurban.kernels.lidar.flat.phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: from `jaxurban.kernels.lidar.flat.lowest_heights`, rounded up to the type of ``roof_m``.
      starts: from `jaxurban.kernels.lidar.flat.phase_starts`.
      halo: H, cells beyond the receivers.
      receiver_phase: the phase in which receivers stand.
    """
    shape = roof_m.shape[1] - 2 * halo, roof_m.shape[2] - 2 * halo
    own_m = terrain_m[receiver_phase, halo : halo + shape[0], halo : halo + shape[1]]
    rise_m = jnp.where(roof_m > 0, roof_m, -jnp.inf)
    num_beams = lowest_m.shape[-1]
    has_returned = num_beams + 1  # in place of the number of beams that have ended
    dtype = jnp.int8 if has_returned <= np.iinfo(np.int8).max else jnp.int32

    def count_at(beams_m: jax.Array) -> jax.Array:
        def step(ended, of_step):
            heights_m, start = of_step
            ground_m = _looks(terrain_m, start, shape) - own_m
            top_m = ground_m + _looks(rise_m, start, shape)
            num_met, num_landed = (_num_not_above(heights_m, level_m, dtype) for level_m in (top_m, ground_m))
            ended = jnp.maximum(ended, jnp.sum(heights_m == -jnp.inf, dtype=dtype))
            is_met = (num_met > ended) & (top_m > -jnp.inf)
            return jnp.where(is_met, jnp.asarray(has_returned, dtype), jnp.maximum(ended, num_landed)), None

        none = jnp.zeros((len(starts), *shape), dtype)
        ended, _ = lax.scan(step, none, (beams_m, starts.swapaxes(0, 1)), unroll=STEPS_AT_ONCE)
        return jnp.sum(ended == has_returned, axis=0, dtype=jnp.int32)

    return lax.map(count_at, lowest_m)


def _looks(rasters: jax.Array, start: jax.Array, shape: tuple[int, int]) -> jax.Array:
    """Return what the cells look at in ``[P, ...]`` rasters along each azimuth, ``[K, *shape]``."""

    def look(corner: jax.Array) -> jax.Array:
        return lax.dynamic_slice(rasters, tuple(corner), (1, *shape))[0]

    return jax.vmap(look)(start)


def _num_not_above(heights_m: jax.Array, level_m: jax.Array, dtype: jnp.dtype) -> jax.Array:
    """Return how many beams, ``[B]``, are not above a level."""
    count = jnp.zeros(level_m.shape, dtype)
    for height_m in heights_m:
        count = count + (height_m <= level_m).astype(dtype)
    return count
