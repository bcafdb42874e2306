"""Soft GPS: the metric with derivatives by roofs, altitude, GDOP threshold and softness."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxurban.errors import InputError
from jaxurban.kernels.dop import Geometry, dops, geometry, unit_vectors
from jaxurban.kernels.occlusion import Line, digital_line
from jaxurban.kernels.soft_occlusion import Window, satellite_weights, shadow_heights
from jaxurban.metrics.gps import BLOCK_CELLS, GpsParams, compute_gps, gps_metric
from jaxurban.soft.checks import check_softness
from jaxurban.soft.obstacle import soft_obstacle
from jaxurban.surface import Surface


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsView:
    """The satellites of one epoch over one surface, made ready on the host; a pytree for `soft_gps`.

    Programs are compiled anew for another number of satellites, shape of the surface or window, not for other
    satellites.

    Attributes:
      lines: the digital line of each satellite, fields stacked along ``S``.
      satellites: their geometry.
      window: the cells of the surface at which maps are wanted.
    """

    lines: Line
    satellites: Geometry
    window: Window = field(metadata={"static": True})

    @classmethod
    def of(cls, surface: Surface, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, oversample: int = 1) -> "GpsView":
        """Return the view of satellites at ``[S]`` azimuths (clockwise from grid north) and elevations.

        Args:
          surface: where the roofs lie; its float type becomes that of the DOPs.
          azimuth_rad, elevation_rad: of the satellites at or above the mask.
          oversample: n, for a surface n times finer than the map (see `jaxurban.oversample`): receivers stand in
            every n-th cell.

        Raises:
          InputError: no satellite, or one below the horizon.
        """
        azimuth, elevation = np.atleast_1d(azimuth_rad).astype(float), np.atleast_1d(elevation_rad).astype(float)
        if not len(azimuth) or np.any(elevation < 0):
            raise InputError(
                f"elevation_rad must hold at least one satellite and none below the horizon, got {elevation.tolist()}: "
                "give those at or above the elevation mask only"
            )
        grid = surface.grid
        lines = [
            digital_line(*angles, grid.resolution_m, grid.first_row, grid.first_col, grid.shape)
            for angles in zip(azimuth, elevation, strict=True)
        ]
        rows, cols = surface.window
        return cls(
            Line(*(np.stack(values) for values in zip(*lines, strict=True))),
            geometry(unit_vectors(azimuth, elevation), np.dtype(surface.roof_m.dtype).type),
            (rows.start, rows.stop, cols.start, cols.stop, oversample),
        )

    def crop(self, values: Float[Array, "Y X"]) -> Float[Array, "y x"]:
        """Return the values of an array on the surface at the receivers' cells."""
        first_row, end_row, first_col, end_col, every = self.window
        return values[first_row + every // 2 : end_row : every, first_col + every // 2 : end_col : every]


def _in_blocks(metric: Callable[[Array], Array], weights: Array) -> Array:
    """Return a metric of ``[S, ...]`` weights, made block by block of cells, so that a gradient keeps them alone."""
    shape = weights.shape[1:]
    num = math.prod(shape)
    size = min(num, BLOCK_CELLS)
    num_blocks = -(-num // size)
    flat = jnp.pad(weights.reshape(len(weights), -1), ((0, 0), (0, num_blocks * size - num)), constant_values=1)
    blocks = flat.reshape(len(weights), num_blocks, size).swapaxes(0, 1)
    return lax.map(jax.checkpoint(metric), blocks).reshape(-1)[:num].reshape(shape)


def soft_gps(
    surface: Surface,
    altitude_m: ArrayLike,
    params: GpsParams,
    softness_m: ArrayLike,
    view: GpsView,
    *,
    cells: Int[Array, "P 2"] | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return soft m_gps at one altitude, on the region ``[y, x]`` or at chosen cells ``[P]``.

    ``m = (1 - soft_obstacle) x (T - min(GDOP, T)) / (T - 1)``, GDOP from satellites weighted by
    `jaxurban.kernels.soft_occlusion.satellite_weights`. As softness goes to 0 it tends to `compute_gps` wherever no
    shadow ends at the altitude itself; at softness 0 it is that but for rounding (`soft_gps_maps` turns to the exact
    program, bit for bit). Fewer than four satellites need no rule of their own: as the fourth weight goes to 0, GDOP
    passes T and m comes to 0. Computed in the type of the roofs.

    Differentiable in ``surface.roof_m`` (and terrain), ``altitude_m``, ``params.gdop_threshold`` and ``softness_m``,
    all of which may be traced; batch by `jax.vmap`. The gradient by roofs and altitude is exact for the soft map while
    the same tops throw the shadows; undefined where two of them tie and where GDOP is just T; 0 in obstacles, where
    GDOP is above T, and in roofs that throw no shadow. By T it is exact, 0 above. Docs: gradients/gps.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground: a number, or one for each cell of the answer.
      params: settings of the metric, of which the threshold is used.
      softness_m: scale of the clearance over which a satellite comes into view; 0 has no gradient in heights.
      view: the satellites over this surface.
      cells: row and column in the region; left out, the whole region. The shadows are cast over the whole
        surface either way. One program is compiled for each number of cells.

    Raises:
      InputError: a softness below 0.
    """
    check_softness(softness_m)
    arguments = altitude_m, params.gdop_threshold, softness_m
    return _soft_gps(surface.roof_m, surface.terrain_m, *arguments, view, cells)


@jax.jit
def _soft_gps(
    roof_m: Array,
    terrain_m: Array | None,
    altitude_m: Array,
    gdop_threshold: Array,
    softness_m: Array,
    view: GpsView,
    cells: Array | None,
) -> Array:
    roof_m = jnp.asarray(roof_m)
    altitude, threshold, softness = (jnp.asarray(v, roof_m.dtype) for v in (altitude_m, gdop_threshold, softness_m))
    shadows_m = shadow_heights(roof_m if terrain_m is None else terrain_m + roof_m, view.lines, view.window)

    def chosen(values: Array) -> Array:
        return values if cells is None else values[..., cells[:, 0], cells[:, 1]]

    height_m = altitude if terrain_m is None else chosen(view.crop(terrain_m)) + altitude
    weights = satellite_weights(height_m, chosen(shadows_m), softness)
    open_m = _in_blocks(lambda block: gps_metric(dops(view.satellites, block).gdop, threshold), weights)
    return (1 - soft_obstacle(chosen(view.crop(roof_m)), altitude, softness)) * open_m


def soft_gps_maps(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike,
    softness_m: float,
    params: GpsParams | None = None,
) -> Float[Array, "A y x"]:
    """Return the soft m_gps at every altitude, for one epoch; with softness 0 that of `compute_gps`, bit for bit.

    Args:
      surface: roofs and terrain of the region and its margin.
      azimuth_rad: ``[S]`` clockwise from grid north, of the satellites at or above the mask.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.
      softness_m: see `soft_gps`; a plain number.
      params: settings; left out, the paper's.

    Raises:
      InputError: a softness that is negative or no number, no satellite, or one below the horizon.
    """
    params = params or GpsParams()
    check_softness(softness_m)
    if softness_m == 0:
        return compute_gps(surface, azimuth_rad, elevation_rad, altitudes_m, params).m
    view = GpsView.of(surface, azimuth_rad, elevation_rad)
    return jnp.stack([soft_gps(surface, z_m, params, softness_m, view) for z_m in np.asarray(altitudes_m, float)])
