"""Lidar returns at every n-th cell of a supersampled raster: the rule of `lidar.flat`, for a map's receivers only.

The receivers of a map lie n subcells apart, so a ray's step looks at the same place among n x n for all of them.
The supersampled raster is therefore kept as n x n rasters of the map's size (`phases`), and a step is a shift of one of
them: a map's cell costs n times the steps of a plain map, not n^3 times.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.host import is_on_host
from jaxurban.kernels.lidar.flat_cpu import count_on_host
from jaxurban.kernels.lidar.steps import count_returns_by_steps


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
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32.

    Equals every n-th result of `jaxurban.kernels.lidar.flat.count_returns` on the supersampled raster. The gradient is
    zero. Where the values lie in a CPU's memory `jaxurban.kernels.lidar.flat_cpu` counts, else
    `jaxurban.kernels.lidar.steps`: the counts are the same.

    Args:
      roof_m: `phases` of roof heights, 0 without a building.
      thresholds_m: ``[A, N]`` from `flat_thresholds` for subcells, rounded up to the type of ``roof_m``.
      starts: ``[K, N, 3]`` from `phase_starts`.
      halo: H, from `halo_cells`.
    """
    if is_on_host(roof_m, thresholds_m, starts):
        return jnp.asarray(count_on_host(roof_m, thresholds_m, np.asarray(starts), halo))
    return count_returns_by_steps(roof_m, thresholds_m, jnp.asarray(starts), halo=halo)
