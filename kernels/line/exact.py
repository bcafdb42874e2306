"""The exact integral of piecewise-constant layers along a polyline, differentiable in waypoints and layers.

``N`` waypoints, ``L`` layers, ``Y`` rows, ``X`` columns. Points are x, y in metres from the map's southwest corner. The
sums are those of `jaxurban.kernels.line.traversal`; unlike a walk from border to border, whose number of steps is only
known once it is over, they are made of arrays of fixed size and can be differentiated backward.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxurban.kernels.line.cuts import cuts, lengths
from jaxurban.kernels.line.traversal import TOUCH_CELLS


@partial(jax.jit, static_argnames="num_borders")
def exact_integrals(
    points_m: Float[Array, "N 2"], layers: Float[Array, "L Y X"], resolution_m: float, *, num_borders: int
) -> tuple[Float[Array, ""], Float[Array, " L"]]:
    """Return a polyline's length, and the integral of each layer along it (layer units times metres).

    Exact: segments are cut at cell borders. A part along a border belongs to the cell north or east of it.

    Gradients: by layers exact, the length in each cell. By waypoints exact where a small move changes neither which
    borders a segment crosses nor their order; 0 of length for a segment of none. Where a segment runs through a corner
    or along a border, or a waypoint lies on one, the integral has a kink or (along a border, as the whole part
    changes cells) a jump; what is given there is the slope on one side, or for a corner that of one of the cells beside
    it. So a grid path with diagonal steps has values but no waypoint gradients worth following: move its points off the
    corners, or use `line-smooth`. Second derivatives are right under the same condition.

    A segment that crosses more than ``num_borders`` rows (or columns), or leaves the map, makes the integrals NaN.

    Args:
      points_m: ``[N, 2]``, ``N >= 1``; repeat the last one to keep shapes few.
      layers: ``[L, Y, X]``, finite where the path runs.
      resolution_m: side of a cell.
      num_borders: rows (columns) that a segment may cross (see `cuts_needed`); time and memory grow with it.
    """
    points = points_m / resolution_m
    begin, along = points[:-1], jnp.diff(points, axis=0)  # [S, 2]
    length = lengths(along)
    at = cuts(begin, along, num_borders)  # [S, P + 1]
    middle = (at[:, 1:] + at[:, :-1]) / 2
    inside = jax.lax.stop_gradient(begin[:, None] + middle[..., None] * along[:, None])
    cell = jnp.floor(inside).astype(jnp.int32)
    share = jnp.diff(at, axis=-1)
    is_on_map = ((cell >= 0) & (cell < jnp.array(layers.shape[:0:-1]))).all(axis=-1)
    is_on_map |= share * length[:, None] < TOUCH_CELLS  # rounding of a path along the map's edge
    col, row = jnp.moveaxis(jnp.where(is_on_map[..., None], cell, 0), -1, 0)
    total = (layers[:, row, col] * share * length[:, None]).sum(axis=(1, 2))
    crossed = jnp.abs(jnp.diff(jnp.floor(points), axis=0)).max(initial=0)
    is_good = (crossed <= num_borders) & is_on_map.all()
    return length.sum() * resolution_m, jnp.where(is_good, total * resolution_m, jnp.nan)


def exact_line_cost(
    points_m: Float[Array, "N 2"],
    layers: Float[Array, "L Y X"],
    resolution_m: float,
    distance_weight: float | Float[Array, ""],
    reference_length_m: float,
    *,
    num_borders: int,
) -> Float[Array, ""]:
    """Return the cost of a polyline under the ``line`` model, to be differentiated (see `exact_integrals`).

    ``distance_weight * length + (1 / reference_length_m) * sum of the integrals``; ``layers`` carry their weights.
    """
    length_m, per_layer = exact_integrals(points_m, layers, resolution_m, num_borders=num_borders)
    return distance_weight * length_m + per_layer.sum() / reference_length_m
