"""The `line-smooth` cost of a climbing polyline over trilinearly interpolated layers, and its gradient.

As `jaxurban.kernels.line.smooth`, one dimension up. ``N`` waypoints, ``L`` layers, ``K`` levels, ``Y`` rows, ``X``
columns. Points are x, y in metres from the map's southwest corner and z in metres, the altitude. A layer's value is met
at the centre of its cell at the altitude of its level; in between it is interpolated, beyond the outermost centres or
levels it is that of the nearest one.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.kernels.line.cuts import cuts, inner_share, lengths
from jaxurban.kernels.line.smooth import LineIntegrals, gauss_integrals


@partial(jax.jit, static_argnames="num_cuts")
def volume_line_integrals(
    points_m: Float[Array, "N 3"],
    layers: Float[Array, "L K Y X"],
    levels_m: Float[Array, " K"],
    resolution_m: float,
    *,
    num_cuts: int,
) -> LineIntegrals:
    """Return a polyline's length in space and the integrals of trilinearly interpolated layers along it.

    Exact but for rounding: a segment is cut at rows and columns of cell centres and at levels, between which the
    interpolant along it is a cubic, which a Gauss rule of two nodes integrates exactly. Gradients by layers and
    waypoints as in `jaxurban.kernels.line.smooth.line_integrals`: exact, one side's where a waypoint lies on a row,
    column or level; by a level's altitude exact too.

    Args:
      points_m: ``[N, 3]`` x, y, altitude, ``N >= 1``; repeat the last one to keep shapes few.
      layers: ``[L, K, Y, X]``.
      levels_m: ``[K]`` ascending altitudes.
      resolution_m: side of a cell.
      num_cuts: rows (columns) of centres that a segment may cross, else NaN
        (`jaxurban.kernels.line.cuts.cuts_needed`).
    """
    points = jnp.concatenate([points_m[:, :2] / resolution_m - 0.5, points_m[:, 2:]], axis=1)
    begin, along = points[:-1], jnp.diff(points, axis=0)  # [S, 3]
    length_m = lengths(jnp.diff(points_m, axis=0))
    fixed, moved = jax.lax.stop_gradient((begin, along))
    at = cuts(fixed[:, :2], moved[:, :2], num_cuts)
    share = inner_share(jax.lax.stop_gradient(levels_m) - fixed[:, 2:], moved[:, 2:])
    at = jnp.sort(jnp.concatenate([at, share], axis=-1), axis=-1)  # [S, P + 1]
    total = gauss_integrals(
        at, length_m, lambda share: _trilinear(layers, levels_m, begin[:, None] + share[..., None] * along[:, None])
    )
    crossed = jnp.abs(jnp.diff(jnp.floor(points[:, :2]), axis=0)).max(axis=-1)
    total = jnp.where(crossed <= num_cuts, total, jnp.nan)
    return LineIntegrals(length_m.sum(), total.sum(axis=-1))


def _trilinear(layers: Array, levels_m: Array, xyz: Array) -> Array:
    """Return ``[L, ...]`` layers interpolated at ``[..., 3]``: cell sides from the southwest centre, altitude."""
    size = np.array(layers.shape[:0:-1])  # columns, rows, levels
    last = jnp.asarray(size - 1)
    z_m = jnp.clip(xyz[..., 2], levels_m[0], levels_m[-1])
    below = jnp.clip(jnp.searchsorted(levels_m, z_m, side="right") - 1, 0, max(int(size[2]) - 2, 0))
    above = jnp.minimum(below + 1, last[2])
    gap_m = levels_m[above] - levels_m[below]
    up = (z_m - levels_m[below]) / jnp.where(gap_m > 0, gap_m, 1.0)
    xy = jnp.clip(xyz[..., :2], 0.0, last[:2].astype(xyz.dtype))
    low = jnp.clip(jnp.floor(xy).astype(jnp.int32), 0, np.maximum(size[:2] - 2, 0))
    east, north = jnp.moveaxis(xy - low, -1, 0)
    value = jnp.zeros((), layers.dtype)
    for level, in_level in ((below, 1 - up), (above, up)):
        for row_step, in_row in ((0, 1 - north), (1, north)):
            for col_step, in_col in ((0, 1 - east), (1, east)):
                row, col = jnp.minimum(low[..., 1] + row_step, last[1]), jnp.minimum(low[..., 0] + col_step, last[0])
                value += layers[:, level, row, col] * (in_level * in_row * in_col)
    return value
