"""Lidar returns at every n-th cell of a supersampled raster: the rule of `lidar.flat`, for a map's receivers only.

The receivers of a map lie n subcells apart, so a ray's step looks at the same place among n x n for all of them.
The supersampled raster is therefore kept as n x n rasters of the map's size (`phases`), and a step is a shift of one of
them: a map's cell costs n times the steps of a plain map, not n^3 times.
"""

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.host import is_on_host
from jaxurban.kernels.lidar.bits import pack
from jaxurban.kernels.lidar.flat_cpu import count_on_host
from jaxurban.kernels.lidar.steps import count_returns_by_steps

WORD_BITS = 8  # few, as each band of rows carries its own halo
STEPS_AT_ONCE = 5  # bitmaps combined per pass over the results


def halo_cells(steps: int, per_cell: int) -> int:
    """Return how many map cells beyond a receiver's own its rays reach, for N steps of a subcell."""
    return (steps - 1 + per_cell // 2) // per_cell


def phases(supersampled: Float[Array, "nY nX"], per_cell: int) -> Float[Array, "P Y X"]:
    """Return the ``n * n`` rasters of every n-th cell; raster p begins at cell (p // n, p % n)."""
    rows, cols = (size // per_cell for size in supersampled.shape)
    split = supersampled.reshape(rows, per_cell, cols, per_cell).transpose(1, 3, 0, 2)
    return split.reshape(per_cell**2, rows, cols)


def phase_starts(offsets: Int[np.ndarray, "K N 2"], per_cell: int) -> Int[np.ndarray, "K N 3"]:
    """Return phase, row and column where each step of each ray finds what the southwest receiver looks at.

    Rows and columns count from the corner of phases that reach `halo_cells` beyond the receivers.

    Args:
      offsets: from `jaxurban.kernels.lidar.flat.ray_offsets`, in subcells from a receiver, which stands in the
        cell (n // 2, n // 2) of its map cell.
      per_cell: n.
    """
    halo = halo_cells(offsets.shape[1], per_cell)
    cell, phase = np.divmod(offsets + per_cell // 2, per_cell)
    starts = [phase[..., 0] * per_cell + phase[..., 1], cell[..., 0] + halo, cell[..., 1] + halo]
    return np.stack(starts, axis=-1).astype(np.int32)


def count_returns_at_centres(
    roof_m: Float[Array, "P Y+2H X+2H"],
    thresholds_m: Float[Array, "A N"],
    starts: Int[Array | np.ndarray, "K N 3"],
    halo: int,
    *,
    shape: Literal["cpu", "gpu"] | None = None,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32.

    Equals every n-th result of `jaxurban.kernels.lidar.flat.count_returns` on the supersampled raster. The gradient is
    zero.

    Args:
      roof_m: `phases` of roof heights, 0 without a building.
      thresholds_m: ``[A, N]`` from `flat_thresholds` for subcells, rounded up to the type of ``roof_m``.
      starts: ``[K, N, 3]`` from `phase_starts`.
      halo: H, from `halo_cells`.
      shape: of the computation where JAX compiles it, for a CPU or a GPU; left out, for the platform for which it is
        compiled, and where the values lie in a CPU's memory `jaxurban.kernels.lidar.flat_cpu`. The counts are the same.
    """
    if shape is None and is_on_host(roof_m, thresholds_m, starts):
        return jnp.asarray(count_on_host(roof_m, thresholds_m, np.asarray(starts), halo))
    return jnp.stack([_count(roof_m, threshold_m, starts, halo=halo, shape=shape) for threshold_m in thresholds_m])


def _count_fn(
    roof_m: jax.Array, threshold_m: jax.Array, starts: jax.Array, *, halo: int, shape: Literal["cpu", "gpu"] | None
) -> jax.Array:
    """Return the counts at one altitude, ``[Y, X]``."""

    def by_steps(roof_m: jax.Array, threshold_m: jax.Array, starts: jax.Array) -> jax.Array:
        return count_returns_by_steps(roof_m, threshold_m[None], starts, halo=halo)[0]

    by_words = partial(_count_by_words, halo=halo)
    if shape is None:
        return lax.platform_dependent(roof_m, threshold_m, starts, cpu=by_words, default=by_steps)
    return (by_words if shape == "cpu" else by_steps)(roof_m, threshold_m, starts)


def _count_by_words(roof_m: jax.Array, threshold_m: jax.Array, starts: jax.Array, *, halo: int) -> jax.Array:
    """Return the counts at one altitude, ``[Y, X]``; bit b of word (i, j) stands for cell (i + b * band, j)."""
    rows, cols = (size - 2 * halo for size in roof_m.shape[1:])
    num_azimuths, steps = starts.shape[:2]
    band = -(-rows // WORD_BITS)
    padded_m = jnp.pad(roof_m, ((0, 0), (0, WORD_BITS * band - rows), (0, 0)))
    highest_m = jnp.nanmax(roof_m)

    def look(first, returned):
        steps_here = [jnp.minimum(first + i, steps - 1) for i in range(STEPS_AT_ONCE)]  # the last again does no harm
        bitmaps = [pack(padded_m, threshold_m[n], band, jnp.uint8) for n in steps_here]

        def add_azimuth(k, returned):
            seen = lax.dynamic_slice(returned, (k, 0, 0), (1, band, cols))
            for n, words in zip(steps_here, bitmaps, strict=True):
                seen = seen | lax.dynamic_slice(words, tuple(starts[k, n]), (1, band, cols))
            return lax.dynamic_update_slice(returned, seen, (k, 0, 0))

        return lax.fori_loop(0, num_azimuths, add_azimuth, returned)

    def look_if_live(i, returned):
        first = i * STEPS_AT_ONCE
        is_live = jnp.any((threshold_m <= highest_m) & (jnp.arange(steps) // STEPS_AT_ONCE == i))
        return lax.cond(is_live, look, lambda _, same: same, first, returned)

    empty = jnp.zeros((num_azimuths, band, cols), jnp.uint8)
    returned = lax.fori_loop(0, -(-steps // STEPS_AT_ONCE), look_if_live, empty)
    counts = [jnp.sum((returned >> bit) & 1, axis=0, dtype=jnp.int32) for bit in range(WORD_BITS)]
    return jnp.concatenate(counts)[:rows]


_count = jax.jit(_count_fn, static_argnames=("halo", "shape"))
