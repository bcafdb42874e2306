"""Distance to the nearest column on a raster, in units of a threshold, differentiable in all that sets it.

``Y, X`` cells that get a result, ``H`` cells of halo around them, ``P`` chosen cells, ``D`` offsets of a disc. Columns
stand at cells and reach up to a top. A receiver's squared distance to one of them is (run / threshold)^2 +
(drop / scale)^2, where the drop is what the top lies below the receiver: a scale equal to the threshold gives Euclid's
distance, a scale of 0 counts only columns that reach the receiver, and one between makes it smooth.

The nearest column is found outside the gradient; what is differentiated is its own distance (one of several at the same
distance), so the gradient costs one scatter.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.distance.exact import OFFSETS_PER_PASS, capped_root, disc, padded_and_size

CELLS_AT_ONCE = 2**12  # chosen cells whose whole discs are looked at together


def squared_drop(drop_m: Float[Array, "*n"], scale_m: Float[Array, ""]) -> Float[Array, "*n"]:
    """Return (drop / scale)^2, 0 where the drop is not above 0; at scale 0 inf where it is."""
    is_soft = scale_m > 0
    below = jnp.maximum(drop_m, 0.0)
    soft = (jnp.where(is_soft, below, 0.0) / jnp.where(is_soft, scale_m, 1.0)) ** 2
    return jnp.where(is_soft | (below == 0), soft, jnp.inf)


def _lower_envelope(squared_m2: jax.Array, axis: int, window: int, resolution_m: float) -> tuple[jax.Array, jax.Array]:
    """Return the lower envelope of parabolas along one axis, and the offset of the cell that it comes from."""
    padded, size = padded_and_size(squared_m2, axis, window)

    def look(state, offset):
        nearest, where = state
        run_m2 = (offset * resolution_m).astype(nearest.dtype) ** 2
        for side in (-1, 1):
            found = lax.dynamic_slice_in_dim(padded, window + side * offset, size, axis) + run_m2
            where = jnp.where(found < nearest, side * offset, where)
            nearest = jnp.minimum(found, nearest)
        return (nearest, where), None

    start = squared_m2, jnp.zeros(squared_m2.shape, jnp.int32)
    offsets = jnp.arange(1, window + 1, dtype=jnp.int32)
    return lax.scan(look, start, offsets, unroll=OFFSETS_PER_PASS)[0]


@partial(jax.jit, static_argnames=("resolution_m", "halo"))
def nearest_column(
    roof_m: Float[Array, "Y+2H X+2H"],
    altitude_m: Float[Array, ""],
    threshold_m: Float[Array, ""],
    scale_m: Float[Array, ""],
    *,
    resolution_m: float,
    halo: int,
) -> Float[Array, "Y X"]:
    """Return the distance to the nearest column in units of the threshold, at most 1, over level ground.

    Args:
      roof_m: column heights with their halo, 0 without a column.
      altitude_m: height of the receivers.
      threshold_m: distance that counts 1; columns farther away than the halo are not looked for.
      scale_m: drop that counts 1.
      resolution_m: side of a cell.
      halo: H.
    """
    source = jnp.where(roof_m > 0, squared_drop(altitude_m - roof_m, scale_m), jnp.inf)
    source_m2 = lax.stop_gradient(source * threshold_m**2)
    along_rows, col_offset = _lower_envelope(source_m2, 1, halo, resolution_m)
    _, row_offset = _lower_envelope(along_rows, 0, halo, resolution_m)
    rows, cols = (size - 2 * halo for size in roof_m.shape)
    row_offset = row_offset[halo : halo + rows, halo : halo + cols]
    row = jnp.arange(rows)[:, None] + halo + row_offset
    col = jnp.arange(cols)[None, :] + halo
    col_offset = col_offset[row, col]
    run_m2 = (row_offset**2 + col_offset**2).astype(roof_m.dtype) * resolution_m**2
    return capped_root(source[row, col + col_offset] + run_m2 / threshold_m**2, 1.0)


@partial(jax.jit, static_argnames=("resolution_m", "halo"))
def nearest_column_at(
    roof_m: Float[Array, "Y+2H X+2H"],
    terrain_m: Float[Array, "Y+2H X+2H"] | None,
    altitude_m: Float[Array, " P"],
    threshold_m: Float[Array, ""],
    scale_m: Float[Array, ""],
    cells: Int[Array, "P 2"],
    *,
    resolution_m: float,
    halo: int,
) -> Float[Array, " P"]:
    """Return `nearest_column` at chosen cells alone, ``[P]``; over terrain receivers and columns stand on it.

    Args:
      roof_m, threshold_m, scale_m, resolution_m, halo: as in `nearest_column`.
      altitude_m: height of each cell's receiver above its ground.
      terrain_m: ground elevation with its halo; None for level ground.
      cells: row and column of each cell, of those without the halo.
    """
    around = jnp.asarray(disc(halo * resolution_m, resolution_m))
    run_m2 = (around.astype(roof_m.dtype) ** 2).sum(axis=1) * resolution_m**2

    @jax.checkpoint
    def nearest(receiver):
        height_m, cell = receiver
        row, col = (cell + halo + around).T
        drop_m = height_m - roof_m[row, col]
        if terrain_m is not None:
            drop_m = drop_m + terrain_m[row[0], col[0]] - terrain_m[row, col]
        source = jnp.where(roof_m[row, col] > 0, squared_drop(drop_m, scale_m), jnp.inf)
        squared = source + run_m2 / threshold_m**2
        return squared[jnp.argmin(lax.stop_gradient(squared))]

    return capped_root(lax.map(nearest, (altitude_m, cells), batch_size=CELLS_AT_ONCE), 1.0)
