"""Shadow heights at every n-th cell of a supersampled raster: the sweep of `shadows.sweep` in bands of n rows.

A map's cells lie n subcells apart both ways, but the lines through them run through all subcells, so each
cell must be looked at once. What can be saved is everything else: n rows are combined in one pass over the
columns, so that the running maximum is read and written once a band, and only every n-th column of every n-th
row is kept.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float


class BandLine(NamedTuple):
    """The digital line of one direction over the bands of a supersampled raster.

    Attributes:
      offsets: ``[B, n]`` int32 sideways cells from each band's receivers to the line's cell 1 to n rows ahead.
      drop_m: float64 height that a ray gains from one row to the next.
      ahead: 1 where the source is beyond the last row, -1 where it is beyond the first.
    """

    offsets: np.ndarray
    drop_m: np.ndarray
    ahead: np.ndarray


def is_along_rows(azimuth_rad: float) -> bool:
    """Return whether a direction is swept row by row; else the kernels want rows and columns exchanged."""
    return abs(math.cos(azimuth_rad)) >= abs(math.sin(azimuth_rad))


def band_line(
    azimuth_rad: float, elevation_rad: float, resolution_m: float, first_band: int, num_bands: int, per_band: int
) -> BandLine:
    """Return the digital line toward a source, in float64 on the host; the cells are those of `digital_line`.

    Args:
      azimuth_rad: direction of the source, clockwise from grid north.
      elevation_rad: its height above the horizon, in (-pi/2, pi/2].
      resolution_m: side of a subcell.
      first_band: global number of the first band: of map rows (of map columns, unless `is_along_rows`).
      num_bands: B.
      per_band: n, rows of subcells in a band; the receivers stand in its row ``n // 2``.
    """
    east, north = math.sin(azimuth_rad), math.cos(azimuth_rad)
    along, across = (north, east) if is_along_rows(azimuth_rad) else (east, north)
    ahead = 1 if along > 0 else -1
    row = (first_band + np.arange(num_bands))[:, None] * per_band + per_band // 2 + ahead * np.arange(per_band + 1)
    offset = np.floor(across / along * row + 0.5)
    return BandLine(
        (offset[:, 1:] - offset[:, :1]).astype(np.int32),
        np.asarray(resolution_m / abs(along) * math.tan(elevation_rad)),
        np.asarray(ahead, np.int32),
    )


@partial(jax.jit, static_argnames=("per_band", "shape"))
def band_shadow_height(
    padded_m: Float[Array, "Y+2n X+2n"],
    line: BandLine,
    entry_steps: float | Array,
    first: tuple[Array | int, Array | int],
    *,
    per_band: int,
    shape: tuple[int, int],
) -> Float[Array, "y x"]:
    """Return `shadow_height` at the receivers of a window of map cells, ``[y, x]``.

    The receiver of map cell (i, j) is the subcell (n i + n // 2, n j + n // 2). Sums are taken band by band from
    the receivers' rows, whose numbers are global, so a part of the raster gives the same bits.

    Args:
      padded_m: tops on the supersampled raster with n rows and columns of -inf around.
      line: from `band_line`, for the raster's bands.
      entry_steps: share of a step before a cell's middle at which a ray meets its roof.
      first: the window's first band and first map column.
      per_band: n.
      shape: bands and map columns of the window.
    """
    n, (num_bands, num_cols) = per_band, shape
    width = padded_m.shape[1] - 2 * n
    drop_m = jnp.asarray(line.drop_m, padded_m.dtype)
    offsets, ahead = jnp.asarray(line.offsets), jnp.asarray(line.ahead)
    climbs_m = (jnp.arange(1, n + 1) - jnp.asarray(entry_steps, padded_m.dtype)) * drop_m
    total = len(offsets)
    first_band, first_col = (jnp.asarray(value, jnp.int32) for value in first)
    num_steps = jnp.where(ahead > 0, total - first_band, first_band + num_bands)

    def step(i, state):
        beyond_m, shadows_m = state
        band = jnp.where(ahead > 0, total - 1 - i, i)
        row = band * n + n // 2 + n  # of the receivers, in the padded raster
        highest_m = lax.dynamic_slice(beyond_m, (n + offsets[band, n - 1],), (width,)) - n * drop_m
        for k in range(n):
            corner = (row + ahead * (k + 1), n + offsets[band, k])
            highest_m = jnp.maximum(highest_m, lax.dynamic_slice(padded_m, corner, (1, width))[0] - climbs_m[k])
        seen_m = lax.dynamic_slice(highest_m[n // 2 :: n], (first_col,), (num_cols,))
        # Bands before the window write to its border row, which its own band overwrites in the end.
        at = jnp.clip(band - first_band, 0, num_bands - 1)
        shadows_m = lax.dynamic_update_slice(shadows_m, seen_m[None], (at, 0))
        return beyond_m.at[n : n + width].set(highest_m), shadows_m

    nothing = jnp.full(width + 2 * n, -jnp.inf, padded_m.dtype)
    empty = jnp.zeros(shape, padded_m.dtype)
    _, shadows_m = lax.fori_loop(0, num_steps, step, (nothing, empty))
    return shadows_m
