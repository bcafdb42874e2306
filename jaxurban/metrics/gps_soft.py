"""m of GDOP, and GPS quality with gradients: satellites come into view over a softness."""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxurban.kernels.blocks import by_cells
from jaxurban.kernels.dop import dops
from jaxurban.kernels.shadows.sweep import Window, shadow_heights
from jaxurban.kernels.soft_step import satellite_weights
from jaxurban.metrics.base import AnyArray
from jaxurban.metrics.reception import ReceptionCurve
from jaxurban.metrics.settings import check_softness
from jaxurban.metrics.visibility import SkyView
from jaxurban.programs import kept_jit
from jaxurban.world.surface import Surface, soft_obstacle

# Made at once: half as many are faster on a CPU, and a third more launches on a GPU.
SOFT_BLOCK_CELLS = 2**12


def gps_metric(gdop: Float[AnyArray, "*C"], gdop_threshold: float | Array) -> Float[Array, "*C"]:
    """Return m = (T - min(GDOP, T)) / (T - 1), clipped to [0, 1], with T the threshold; 0 at GDOP = inf.

    Source: the paper's equation of m_gps, its GDOP_cut taken as T = GDOP_thresh. The derivative is 0
    beyond the threshold.

    Args:
      gdop: GDOP, or another DOP, in any shape.
      gdop_threshold: above 1.
    """
    below = gdop_threshold - jnp.minimum(gdop, gdop_threshold)
    return jnp.clip(below / (gdop_threshold - 1), 0, 1)


def soft_gps(
    surface: Surface,
    altitude_m: ArrayLike,
    threshold: ArrayLike,
    softness_m: ArrayLike,
    view: SkyView,
    *,
    dop: str = "gdop",
    cells: Int[Array, "P 2"] | None = None,
    reception: ReceptionCurve | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return soft m_gps at one altitude, on the region ``[y, x]`` or at chosen cells ``[P]``.

    ``m = (1 - soft_obstacle) x (T - min(GDOP, T)) / (T - 1)``, where T is the threshold and GDOP is that of satellites
    weighted by `jaxurban.kernels.soft_step.satellite_weights`. As the softness goes to 0, the map tends to the exact
    map wherever no shadow ends at the altitude itself; at softness 0 the two differ by rounding alone. Fewer than four
    satellites need no rule of their own: as the fourth weight goes to 0, GDOP passes T and m becomes 0. The map has the
    type of the roofs.

    The map is differentiable in ``surface.roof_m`` (and terrain), ``altitude_m``, ``threshold`` and ``softness_m``, all
    of which may be traced; batch it by `jax.vmap`. The gradient by roofs and altitude is exact for the soft map as long
    as the same roofs throw the shadows. It is undefined where two of them tie and where GDOP equals T, and 0 in
    obstacles, where GDOP is above T, and in roofs that throw no shadow. The gradient by T is exact, and 0 where GDOP is
    above T. Docs: algorithms/gradients.md.

    With ``reception`` the weight of a satellite is the chance that it is heard, independently of the others. Its margin
    is measured to the shadow of roofs alone, as in the log that the curve was fitted to: open ground below an antenna
    throws none. A satellite that no roof shadows has the chance at the curve's cut, so that an open sky is worse than
    in the exact map. Hills still hide satellites by the softness, and roofs are obstacles by it. The map is then
    differentiable in the leaves of the curve too.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground: a number, or one for each cell of the result.
      threshold: DOP at and above which m is 0.
      softness_m: scale of the clearance over which a satellite comes into view; 0 has no gradient in heights.
      view: the satellites over this surface.
      dop: which field of `jaxurban.kernels.dop.Dops` counts; ``"hdop"``, for one, takes the place of GDOP.
      cells: row and column in the region; left out, the whole region. The shadows are cast over the whole
        surface either way. One program is compiled for each number of cells.
      reception: chance that a satellite is heard, in place of the logistic of the softness.

    Raises:
      InputError: a softness below 0.
    """
    check_softness(softness_m)
    return _soft_gps(
        surface.roof_m,
        surface.of_hiding().roof_m,
        surface.terrain_m,
        altitude_m,
        threshold,
        softness_m,
        view,
        cells,
        reception,
        window=surface.window_ends,
        dop=dop,
    )


@partial(kept_jit, static_argnames=("window", "dop"))
def _soft_gps(
    roof_m: Array,
    hiding_m: Array,
    terrain_m: Array | None,
    altitude_m: Array,
    dop_threshold: Array,
    softness_m: Array,
    view: SkyView,
    cells: Array | None,
    reception: ReceptionCurve | None,
    *,
    window: Window,
    dop: str,
) -> Array:
    """Return the soft metric of one DOP on the region, ``[y, x]``, or at chosen cells, ``[P]``.

    Args:
      roof_m, hiding_m, terrain_m: ``[Y, X]`` on the surface's grid: all roofs, those that hide satellites, and no
        terrain where the ground is flat.
      altitude_m, dop_threshold, softness_m, view, cells, reception, dop: as for `soft_gps`.
      window: the region's first and end row, first and end column.
    """
    roof_m = jnp.asarray(roof_m)
    first_row, end_row, first_col, end_col = window
    altitude = jnp.asarray(altitude_m, roof_m.dtype)
    threshold = jnp.asarray(dop_threshold, roof_m.dtype)
    softness = jnp.asarray(softness_m, roof_m.dtype)

    def chosen(values: Array) -> Array:
        """Return the chosen cells of an array on the region, or all of them."""
        return values if cells is None else values[..., cells[:, 0], cells[:, 1]]

    def at_receivers(values: Array) -> Array:
        """Return the chosen cells of an array on the surface's grid."""
        return chosen(values[first_row:end_row, first_col:end_col])

    # Shadows of roofs and ground or, with a curve of reception, of roofs alone: height of their edge by satellite.
    top_m = hiding_m if terrain_m is None else terrain_m + hiding_m
    if reception is not None:
        top_m = jnp.where(hiding_m > 0, top_m, -jnp.inf)
    shadows_m = shadow_heights(top_m, view.lines, window)

    # Weights of satellites by the height of receivers over these edges; hills hide satellites in either case.
    height_m = altitude if terrain_m is None else at_receivers(terrain_m) + altitude
    chance = None if reception is None else reception.chance
    weights = satellite_weights(height_m, chosen(shadows_m), softness, chance)
    if reception is not None and terrain_m is not None:
        by_hills_m = shadow_heights(terrain_m, view.lines, window)
        weights = weights * satellite_weights(height_m, chosen(by_hills_m), softness)

    @jax.checkpoint  # so that a gradient keeps the weights alone
    def metric(weights: Array) -> Array:
        """Return m of a block of cells, from the weights of their satellites."""
        return gps_metric(getattr(dops(view.satellites, weights), dop), threshold)

    num_together = min(math.prod(weights.shape[1:]), SOFT_BLOCK_CELLS)
    m_outdoors = by_cells(metric, weights, num_together)
    return (1 - soft_obstacle(at_receivers(roof_m), altitude, softness)) * m_outdoors
