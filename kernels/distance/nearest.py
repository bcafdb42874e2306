"""Distance to the nearest source on a raster, exact and up to a cap; to columns also differentiable in what sets it.

``Y, X`` cells that get a result, ``H`` cells of halo around them, ``N`` cells of a column, ``P`` chosen cells, ``D``
offsets of a disc. Exact distances are between cell centres; beyond the halo there is nothing. Gradients are those of
the nearest source's distance (shared where several tie), and zero at the cap and at distance 0. The cap may be traced:
what stands in the halo beyond it changes nothing, so that one halo serves all caps up to it.

Columns stand at cells and reach up to a top. A receiver's squared distance to one of them is (run / threshold)^2 +
(drop / scale)^2, where the drop is what the top lies below the receiver: a scale equal to the threshold gives Euclid's
distance, a scale of 0 counts only columns that reach the receiver, and one between makes it smooth. The nearest column
is found outside the gradient, and its own distance alone is differentiated (one of several at the same distance), so
the gradient costs one scatter.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, DTypeLike, Float, Int

from jaxurban.programs import kept_jit

OFFSETS_PER_PASS = 4  # offsets looked at per pass over the cells: 1.2 times faster than one by one
CELLS_AT_ONCE = 2**12  # chosen cells whose whole discs are looked at together
# A disc is filled up to a multiple of so many offsets, so that few programs are compiled.
DISC_STEP = 64
# Top of a cell without a column: finite, so that its square's gradient is too.
OUT_OF_REACH_M = -1e9


def window_cells(cap_m: float, resolution_m: float) -> int:
    """Return how many cells away a source may stand and still be nearer than ``cap_m``."""
    return math.ceil(cap_m / resolution_m)


def squared_runs(halo: int, resolution_m: float, dtype: DTypeLike) -> Float[np.ndarray, " H+1"]:
    """Return the squared distance of 0 to ``halo`` cells, in square metres."""
    run_m = np.arange(halo + 1).astype(dtype) * np.asarray(resolution_m, dtype)
    return run_m**2


def capped_root(squared: Float[Array, "*n"], cap: Float[Array, ""] | float) -> Float[Array, "*n"]:
    """Return the square root, at most the cap and at least 0, with gradient 0 at and beyond both."""
    is_inside = (squared > 0) & (squared < cap**2)
    root = jnp.sqrt(jnp.where(is_inside, squared, 1.0))
    return jnp.where(is_inside, root, jnp.where(squared > 0, cap, 0.0).astype(root.dtype))


class Disc(NamedTuple):
    """The cells around a cell.

    Attributes:
      offsets: ``[D, 2]`` rows and columns away.
      run_m2: ``[D]`` squared distance of each, in square metres.
    """

    offsets: Int[Array | np.ndarray, "D 2"]
    run_m2: Float[Array | np.ndarray, " D"]


def disc(radius_m: float, resolution_m: float, dtype: DTypeLike) -> Disc:
    """Return the cells whose centre is nearer than a radius to a cell's, the nearest first, that cell included.

    Repetitions of the cell itself (offset 0, 0) at the end fill the list up to a multiple of `DISC_STEP`; a minimum
    over the disc does not change by them.

    Args:
      radius_m: distance that all of these cells are nearer than.
      resolution_m: side of a cell.
      dtype: type of the squared distances.
    """
    window = window_cells(radius_m, resolution_m)
    span = np.arange(-window, window + 1)
    offsets = np.stack(np.meshgrid(span, span, indexing="ij"), axis=-1).reshape(-1, 2)
    run_m = np.hypot(*offsets.T) * resolution_m
    order = np.argsort(run_m, kind="stable")
    is_nearer = run_m[order] < radius_m
    nearer = offsets[order[is_nearer]]
    filled = np.pad(nearer, [(0, -len(nearer) % DISC_STEP), (0, 0)]).astype(np.int32)
    run_m2 = (filled.astype(float) ** 2).sum(axis=1) * resolution_m**2
    return Disc(filled, run_m2.astype(dtype))


def nearest_along(
    squared_m2: Float[Array, " N+2H"], run_m2: Float[Array, " H+1"]
) -> tuple[Float[Array, " N"], Int[Array, " N"]]:
    """Return the squared distance to the nearest source along one line of cells, and how many cells away it stands.

    The line is a row or a column of a raster. This is the lower envelope of parabolas (Felzenszwalb and Huttenlocher
    2012, eq. 2), by brute force over the halo. Ending the search where no cell could come nearer was tried: the test
    costs more than it saves.

    Args:
      squared_m2: ``[N + 2 H]`` what each cell's source adds to the squared distance, in square metres; inf without one.
      run_m2: ``[H + 1]`` from `squared_runs`; its length gives H, the cells of halo at either end.

    Returns:
      ``[N]`` the squared distance, inf where no source is near enough, and ``[N]`` int32 the offset of the source in
      cells, negative toward the line's beginning (0 also without a source).
    """
    halo = len(run_m2) - 1
    num = len(squared_m2) - 2 * halo

    def look(
        state: tuple[Array, Array], step: tuple[Array, Array]
    ) -> tuple[tuple[Array, Array], None]:
        """Compare the two sources at one distance, before and behind each cell, with the nearest one so far."""
        nearest_m2, nearest_offset = state
        distance, distance_m2 = step
        for offset in (-distance, distance):
            source_m2 = lax.dynamic_slice(squared_m2, (halo + offset,), (num,)) + distance_m2
            nearest_offset = jnp.where(source_m2 < nearest_m2, offset, nearest_offset)
            nearest_m2 = jnp.minimum(source_m2, nearest_m2)
        return (nearest_m2, nearest_offset), None

    # Begin with each cell's own source, at offset 0.
    start = squared_m2[halo : halo + num], jnp.zeros(num, jnp.int32)
    steps = jnp.arange(1, halo + 1, dtype=jnp.int32), run_m2[1:]
    return lax.scan(look, start, steps, unroll=OFFSETS_PER_PASS)[0]


@kept_jit
def capped_distance(
    source_m2: Float[Array, "Y+2H X+2H"], run_m2: Float[Array, " H+1"], cap_m: Float[Array, ""]
) -> Float[Array, "Y X"]:
    """Return the distance to the nearest source, at most ``cap_m``, ``[Y, X]`` metres.

    Args:
      source_m2: what each cell's source adds to the squared distance: 0 for a source at the receivers' height, the
        square of the drop for one below it, inf without a source.
      run_m2: from `squared_runs`, of a halo of at least `window_cells` of the cap.
      cap_m: cap; may be traced.

    Squared distances separate: a pass along rows, then one along columns.
    """
    along_rows, _ = jax.vmap(nearest_along, (0, None))(source_m2, run_m2)
    squared_m2, _ = jax.vmap(nearest_along, (1, None), 1)(along_rows, run_m2)
    return capped_root(squared_m2, cap_m)


@kept_jit
def capped_distance_over_terrain(
    receiver_m: Float[Array, "Y X"],
    top_m: Float[Array, "Y+2H X+2H"],
    is_source: Bool[Array, "Y+2H X+2H"],
    around: Disc,
    cap_m: Float[Array, ""],
) -> Float[Array, "Y X"]:
    """Return the distance from each receiver to the nearest column at or below a top, at most ``cap_m``.

    With terrain the drop from receiver to roof depends on both cells, so nothing separates: every
    offset of a disc is tried (5 m cells and 50 m: 317; 2 m cells: 1,961), one at a time.

    Args:
      receiver_m: height of each cell's receiver.
      top_m: height of each cell's column top, in the frame of ``receiver_m``.
      is_source: cells that hold a column.
      around: the cells nearer than the cap, from `disc`, none farther away than H.
      cap_m: cap; may be traced.
    """
    halo = (len(top_m) - len(receiver_m)) // 2
    tops_m = jnp.where(is_source, top_m, OUT_OF_REACH_M)

    def look(nearest: Array, cell: Disc) -> tuple[Array, None]:
        """Lower ``[Y, X]`` squared distances by the columns at one offset of the disc from each receiver."""
        row, col = cell.offsets + halo
        drop_m = jnp.maximum(receiver_m - lax.dynamic_slice(tops_m, (row, col), nearest.shape), 0.0)
        return jnp.minimum(nearest, drop_m**2 + cell.run_m2), None

    nothing = jnp.full(receiver_m.shape, jnp.inf, receiver_m.dtype)
    return capped_root(lax.scan(look, nothing, around, unroll=OFFSETS_PER_PASS)[0], cap_m)


def squared_drop(drop_m: Float[Array, "*n"], scale_m: Float[Array, ""]) -> Float[Array, "*n"]:
    """Return (drop / scale)^2, 0 where the drop is not above 0; at scale 0 inf where it is."""
    is_soft = scale_m > 0
    below = jnp.maximum(drop_m, 0.0)
    soft = (jnp.where(is_soft, below, 0.0) / jnp.where(is_soft, scale_m, 1.0)) ** 2
    return jnp.where(is_soft | (below == 0), soft, jnp.inf)


@kept_jit
def nearest_column(
    roof_m: Float[Array, "Y+2H X+2H"],
    altitude_m: Float[Array, ""],
    threshold_m: Float[Array, ""],
    scale_m: Float[Array, ""],
    run_m2: Float[Array, " H+1"],
) -> Float[Array, "Y X"]:
    """Return the distance to the nearest column in units of the threshold, at most 1, over level ground.

    Args:
      roof_m: column heights with their halo, 0 without a column.
      altitude_m: height of the receivers.
      threshold_m: distance that counts 1; columns farther away than the halo are not looked for.
      scale_m: drop that counts 1.
      run_m2: from `squared_runs`.
    """
    # Which column is the nearest, outside the gradient: along each row, then along each column of these minima.
    source = jnp.where(roof_m > 0, squared_drop(altitude_m - roof_m, scale_m), jnp.inf)
    source_m2 = lax.stop_gradient(source * threshold_m**2)
    along_rows, col_offsets = jax.vmap(nearest_along, (0, None))(source_m2, run_m2)
    _, row_offset = jax.vmap(nearest_along, (1, None), 1)(along_rows, run_m2)

    # Its own distance, which is differentiated. Rows still have their halo, columns have lost it by the first pass.
    rows, cols = row_offset.shape
    halo = len(run_m2) - 1
    row = jnp.arange(rows)[:, None] + halo + row_offset
    col = jnp.arange(cols)[None, :]
    col_offset = col_offsets[row, col]
    squared_run_m2 = run_m2[abs(row_offset)] + run_m2[abs(col_offset)]
    return capped_root(source[row, col + halo + col_offset] + squared_run_m2 / threshold_m**2, 1.0)


@partial(kept_jit, static_argnames=("halo",))
def nearest_column_at(
    roof_m: Float[Array, "Y+2H X+2H"],
    terrain_m: Float[Array, "Y+2H X+2H"] | None,
    altitude_m: Float[Array, " P"],
    threshold_m: Float[Array, ""],
    scale_m: Float[Array, ""],
    cells: Int[Array, "P 2"],
    around: Disc,
    *,
    halo: int,
) -> Float[Array, " P"]:
    """Return `nearest_column` at chosen cells alone, ``[P]``; over terrain receivers and columns stand on it.

    Args:
      roof_m, threshold_m, scale_m, halo: as in `nearest_column`.
      altitude_m: height of each cell's receiver above its ground.
      terrain_m: ground elevation with its halo; None for level ground.
      cells: row and column of each cell, of those without the halo.
      around: where columns are looked for, from `disc`, none farther away than the halo.
    """

    @jax.checkpoint
    def nearest(receiver):
        """Return the squared distance, in thresholds, from one receiver (height, cell) to its nearest column."""
        height_m, cell = receiver
        row, col = (cell[None] + halo + around.offsets).T
        drop_m = height_m - roof_m[row, col]
        if terrain_m is not None:
            # The disc begins with offset 0, 0: there is the receiver's own ground.
            drop_m = drop_m + terrain_m[row[0], col[0]] - terrain_m[row, col]
        source = jnp.where(roof_m[row, col] > 0, squared_drop(drop_m, scale_m), jnp.inf)
        squared = source + around.run_m2 / threshold_m**2
        # Chosen outside the gradient, so that one column alone is differentiated.
        return squared[jnp.argmin(lax.stop_gradient(squared))]

    return capped_root(lax.map(nearest, (altitude_m, cells), batch_size=CELLS_AT_ONCE), 1.0)
