"""The `line-smooth` cost of a polyline over bilinearly interpolated layers, and its gradient.

``N`` waypoints, ``L`` layers, ``Y`` rows, ``X`` columns. Points are x, y in metres from the map's southwest corner; a
layer's value is met at the centre of its cell and interpolated between centres; beyond the outermost centres it is
that of the nearest one.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxurban.kernels.line.cuts import cuts, lengths

NODE = 1 / math.sqrt(3.0)  # of the Gauss-Legendre rule with two nodes on [-1, 1]


class LineIntegrals(NamedTuple):
    """What a polyline collects.

    Attributes:
      length_m: Euclidean length.
      per_layer_m: ``[L]`` integral of each layer along it, in layer units times metres.
    """

    length_m: Float[Array, ""]
    per_layer_m: Float[Array, " L"]


@partial(jax.jit, static_argnames="num_cuts")
def line_integrals(
    points_m: Float[Array, "N 2"], layers: Float[Array, "L Y X"], resolution_m: float, *, num_cuts: int
) -> LineIntegrals:
    """Return a polyline's length and the integrals of bilinearly interpolated layers along it.

    Exact but for rounding: a segment is cut where it crosses the rows and columns of cell centres, between which the
    interpolant along it is a quadratic, and a Gauss rule of two nodes integrates cubics exactly.

    Gradients are exact too, and finite everywhere for finite layers: with respect to layers always; with respect to
    waypoints wherever the interpolant has one, elsewhere (a waypoint on a row or column of centres) that of one side.
    A segment of no length adds nothing, and a zero gradient of length, where there is none. The cuts are held
    fixed, which changes no first derivative, since the interpolant is continuous there; second derivatives are not
    right. Beyond the outermost centres the layers' gradient is zero.

    A segment that crosses more than ``num_cuts`` rows, or columns, of centres makes the integrals NaN. A NaN in a
    layer spreads to segments through the four squares between centres around it: fill obstacles before.

    Args:
      points_m: ``[N, 2]``, ``N >= 1``; repeat the last one to keep shapes few.
      layers: ``[L, Y, X]``.
      resolution_m: side of a cell.
      num_cuts: rows (columns) of centres that a segment may cross (see `cuts_needed`); time and memory grow with it.
    """
    points = points_m / resolution_m - 0.5
    begin, along = points[:-1], jnp.diff(points, axis=0)  # [S, 2]
    length = lengths(along)
    at = cuts(jax.lax.stop_gradient(begin), jax.lax.stop_gradient(along), num_cuts)  # [S, P + 1]
    total = gauss_integrals(
        at, length, lambda share: _bilinear(layers, begin[:, None] + share[..., None] * along[:, None])
    )
    crossed = jnp.abs(jnp.diff(jnp.floor(points), axis=0)).max(axis=-1)
    total = jnp.where(crossed <= num_cuts, total, jnp.nan)
    return LineIntegrals(length.sum() * resolution_m, total.sum(axis=-1) * resolution_m)


def line_smooth(
    points_m: Float[Array, "N 2"],
    layers: Float[Array, "L Y X"],
    resolution_m: float,
    distance_weight: float | Float[Array, ""],
    reference_length_m: float,
    *,
    num_cuts: int,
) -> Float[Array, ""]:
    """Return the cost of a polyline: ``distance_weight * length + (1 / reference_length_m) * sum of the integrals``.

    The line cost model with layers interpolated instead of constant in each cell (see `line_integrals`, also for
    weights that are to be differentiated one by one). It differs from that model's exact cost by what
    interpolation changes: nothing on layers that are linear in x and y, away from the border.

    Args:
      points_m, layers, resolution_m, num_cuts: see `line_integrals`; ``layers`` carry their weights.
      distance_weight: cost per metre.
      reference_length_m: ``l_0`` of the line model.
    """
    integrals = line_integrals(points_m, layers, resolution_m, num_cuts=num_cuts)
    return distance_weight * integrals.length_m + integrals.per_layer_m.sum() / reference_length_m


def gauss_integrals(at: Array, length: Array, value_at: Callable[[Array], Array]) -> Array:
    """Return ``[L, S]`` integrals of layers along segments, by a Gauss rule of two nodes on each part.

    Args:
      at: ``[S, P + 1]`` where the parts of each segment begin and end, as shares of it.
      length: ``[S]`` of the segments.
      value_at: gives the layers' values ``[L, S, P]`` at shares ``[S, P]`` of the segments.
    """
    middle, half = (at[:, 1:] + at[:, :-1]) / 2, (at[:, 1:] - at[:, :-1]) / 2
    return sum((value_at(middle + node * half) * half).sum(axis=-1) for node in (-NODE, NODE)) * length


def _bilinear(layers: Array, xy: Array) -> Array:
    """Return ``[L, ...]`` layers interpolated at points ``[..., 2]`` in cell sides from the southwest centre."""
    size = np.array(layers.shape[:0:-1])  # columns, rows
    xy = jnp.clip(xy, 0.0, jnp.asarray(size - 1, xy.dtype))
    low = jnp.clip(jnp.floor(xy).astype(jnp.int32), 0, np.maximum(size - 2, 0))
    east, north = (xy - low)[..., 0], (xy - low)[..., 1]
    (col, row), (next_col, next_row) = (jnp.moveaxis(corner, -1, 0) for corner in (low, jnp.minimum(low + 1, size - 1)))
    south = layers[:, row, col] * (1 - east) + layers[:, row, next_col] * east
    return south * (1 - north) + (layers[:, next_row, col] * (1 - east) + layers[:, next_row, next_col] * east) * north
