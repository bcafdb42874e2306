"""Distance to the nearest source on a raster, exact and up to a cap; to columns also differentiable in what sets it.

``Y, X`` cells that get a result, ``H`` cells of halo around them, ``P`` chosen cells, ``D`` offsets of a disc. Exact
distances are between cell centres; outside the arrays there is nothing. Gradients are those of the nearest source's
distance (shared where several tie), and zero at the cap and at distance 0. On a CPU, where nothing is traced,
`jaxurban.kernels.distance.nearest_cpu` gives the same bits sooner.

Columns stand at cells and reach up to a top. A receiver's squared distance to one of them is (run / threshold)^2 +
(drop / scale)^2, where the drop is what the top lies below the receiver: a scale equal to the threshold gives Euclid's
distance, a scale of 0 counts only columns that reach the receiver, and one between makes it smooth. The nearest column
is found outside the gradient; what is differentiated is its own distance (one of several at the same distance), so the
gradient costs one scatter.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

OFFSETS_PER_PASS = (
    5  # offsets looked at per pass over the cells: 1.5 times faster than one by one on large maps
)
CELLS_AT_ONCE = 2**12  # chosen cells whose whole discs are looked at together
OUT_OF_REACH_M = (
    -1e9
)  # top of a cell without a column: finite, so that its square's gradient is too


def window_cells(cap_m: float, resolution_m: float) -> int:
    """Return how many cells away a source may stand and still be nearer than ``cap_m``."""
    return math.ceil(cap_m / resolution_m)


def capped_root(squared: Float[Array, "*n"], cap: float) -> Float[Array, "*n"]:
    """Return the square root, at most the cap and at least 0, with gradient 0 at and beyond both."""
    is_inside = (squared > 0) & (squared < cap**2)
    root = jnp.sqrt(jnp.where(is_inside, squared, 1.0))
    return jnp.where(is_inside, root, jnp.where(squared > 0, cap, 0.0).astype(root.dtype))


def disc(radius_m: float, resolution_m: float) -> Int[np.ndarray, "D 2"]:
    """Return the offsets, rows and columns, of the cells nearer than a radius, the cell's own first."""
    window = window_cells(radius_m, resolution_m)
    span = np.arange(-window, window + 1)
    offsets = np.stack(np.meshgrid(span, span, indexing="ij"), axis=-1).reshape(-1, 2)
    run_m = np.hypot(*offsets.T) * resolution_m
    order = np.argsort(run_m, kind="stable")
    return offsets[order[run_m[order] < radius_m]].astype(np.int32)


@partial(jax.jit, static_argnames=("resolution_m", "cap_m"))
def capped_distance(
    source_m2: Float[Array, "Y X"], *, resolution_m: float, cap_m: float
) -> Float[Array, "Y X"]:
    """Return the distance to the nearest source, at most ``cap_m``, ``[Y, X]`` metres.

    Args:
      source_m2: ``[Y, X]`` what a source adds to the squared distance: 0 where it stands at the
        cell itself, a squared height where it stands below it, inf without a source.
      resolution_m: side of a cell.
      cap_m: cap; sources farther away are not looked for.

    Squared distances separate: a pass along rows, then one along columns, each the lower envelope
    of parabolas (Felzenszwalb and Huttenlocher 2012, eq. 2), here by brute force over a window,
    which is exact up to the cap.
    """
    window = window_cells(cap_m, resolution_m)
    along_rows, _ = _lower_envelope(source_m2, 1, window, resolution_m)
    return capped_root(_lower_envelope(along_rows, 0, window, resolution_m)[0], cap_m)


@partial(jax.jit, static_argnames=("resolution_m", "cap_m"))
def capped_distance_over_terrain(
    receiver_m: Float[Array, "Y X"],
    top_m: Float[Array, "Y X"],
    is_source: Bool[Array, "Y X"],
    *,
    resolution_m: float,
    cap_m: float,
) -> Float[Array, "Y X"]:
    """Return the distance from each receiver to the nearest column at or below a top, at most ``cap_m``.

    With terrain the drop from receiver to roof depends on both cells, so nothing separates: every
    offset of a disc is tried (5 m cells and 50 m: 317; 2 m cells: 1,961), one at a time.

    Args:
      receiver_m: ``[Y, X]`` height of each cell's receiver.
      top_m: ``[Y, X]`` height of each cell's column top, in the frame of ``receiver_m``.
      is_source: ``[Y, X]`` cells that hold a column.
      resolution_m: side of a cell.
      cap_m: cap; sources farther away are not looked for.
    """
    window = window_cells(cap_m, resolution_m)
    rows, cols = disc(cap_m, resolution_m).T
    run_m2 = (rows**2 + cols**2) * resolution_m**2
    padded = jnp.pad(
        jnp.where(is_source, top_m, OUT_OF_REACH_M), window, constant_values=OUT_OF_REACH_M
    )

    def add_offset(nearest, offset):
        row, col, offset_m2 = offset
        top = lax.dynamic_slice(padded, (row + window, col + window), top_m.shape)
        drop_m = jnp.maximum(receiver_m - top, 0.0)
        return jnp.minimum(nearest, drop_m**2 + offset_m2), None

    offsets = jnp.asarray(rows), jnp.asarray(cols), jnp.asarray(run_m2, receiver_m.dtype)
    nearest, _ = lax.scan(add_offset, jnp.full(top_m.shape, jnp.inf, receiver_m.dtype), offsets)
    return capped_root(nearest, cap_m)


def squared_drop(drop_m: Float[Array, "*n"], scale_m: Float[Array, ""]) -> Float[Array, "*n"]:
    """Return (drop / scale)^2, 0 where the drop is not above 0; at scale 0 inf where it is."""
    is_soft = scale_m > 0
    below = jnp.maximum(drop_m, 0.0)
    soft = (jnp.where(is_soft, below, 0.0) / jnp.where(is_soft, scale_m, 1.0)) ** 2
    return jnp.where(is_soft | (below == 0), soft, jnp.inf)


def _lower_envelope(
    squared_m2: jax.Array, axis: int, window: int, resolution_m: float
) -> tuple[jax.Array, jax.Array]:
    """Return the lower envelope of parabolas along one axis, and the offset of the cell that it comes from."""
    margins = [(window, window) if k == axis else (0, 0) for k in (0, 1)]
    padded, size = jnp.pad(squared_m2, margins, constant_values=jnp.inf), squared_m2.shape[axis]

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
