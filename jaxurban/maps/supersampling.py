"""Supersampling: occlusion and lidar on a surface n times finer than the map, with results at the map's cells.

The receiver of a map cell stands in the subcell that holds the map cell's centre; with an even n, whose centre is
a corner of four subcells, in the northeastern one: half a subcell off (prefer odd n). Obstacles stay those of
the map's own cells, which for outlines are what their centres' subcells say.

Bounds: with n rows of subcells known to be covered in full, or not at all, a satellite's visibility can be certain.
`upper_bands` lets roofs cover every subcell they touch, and a ray meet the highest of the three cells that the true
ray may cross in each row, from where it enters the row: who is seen under these is seen in truth. `lower_bands`
lets roofs cover the subcells whose eight neighbours they cover as well, and a ray meet the lowest of the three:
who is hidden under these is hidden in truth (but for gaps narrower than a subcell between outlines, which
centres of subcells may miss). Both hold for flat-topped prisms, over terrain taken as the surface's steps. As one
satellite more never makes a GDOP larger, m under the two brackets the true m (the map's own m, an estimate between the
two rules, may lie outside where it errs). On plain cells (n = 1) the bounds
are valid but wide: a cell on each side closes streets.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt

from jaxurban.errors import InputError
from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.shadows.supersampled import band_line, band_shadow_height, is_along_rows
from jaxurban.kernels.shadows.sweep import ENTRY_STEPS, WORD_BITS
from jaxurban.metrics.visibility import above_horizon, without_hidden
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

WHOLE_ROW_STEPS = 0.5  # from a row's middle to where a ray enters it


def supersampled_grid(grid: Grid, oversample: int) -> Grid:
    """Return the grid over the same box whose cells are n times smaller.

    Raises:
      InputError: ``oversample`` is not a whole number of at least 1.
    """
    if not (isinstance(oversample, int) and oversample >= 1):
        raise InputError(f"oversample must be a whole number of at least 1 (odd ones are best), got {oversample!r}")
    return grid.refined(oversample)


def build_supersampled_surface(
    city: City, region: Grid, grid: Grid, oversample: int, all_touched: bool = False
) -> Surface:
    """Return the city as rasters n times finer than the map's ``region`` and its surrounding ``grid``.

    Raises:
      InputError: as for `build_surface`, or an ``oversample`` that is not a whole number of at least 1.
    """
    without_blocks = replace(city, blocks=None)
    supersampled = build_surface(
        without_blocks,
        supersampled_grid(region, oversample),
        supersampled_grid(grid, oversample),
        all_touched=all_touched,
    )
    return replace(supersampled, roof_touched_m=None)


@dataclass(frozen=True)
class Bands:
    """What shadows the cells of a map, ready for sweeps in both directions. ``Y, X`` subcells, ``y, x`` map cells.

    Attributes:
      along_rows: ``[Y + 2n, X + 2n]`` absolute height of tops, -inf around.
      along_cols: ``[X + 2n, Y + 2n]`` the same for sweeps along columns, turned.
      own_m: ``[y, x]`` top that hides all below it in the receiver's own cell; -inf where nothing does.
      ground_m: ``[y, x]`` terrain of the receivers; None for flat ground.
      entry_steps: share of a step before a row's middle at which a ray meets its roofs.
      surface: the supersampled surface; its slabs count where ``has_slabs``.
      oversample: n.
      has_slabs: whether what hangs shadows too, between floor and top.
    """

    along_rows: Float[Array, "Y+2n X+2n"]
    along_cols: Float[Array, "X+2n Y+2n"]
    own_m: Float[Array, "y x"] | float
    ground_m: Float[Array, "y x"] | None
    entry_steps: float
    surface: Surface
    oversample: int
    has_slabs: bool = False


def _widest(tops_m: jax.Array, axis: int, pick: Callable) -> jax.Array:
    """Return the highest (lowest) of each cell and its neighbours along an axis; nothing stands beyond the edge."""
    width = [(0, 0), (0, 0)]
    width[axis] = (1, 1)
    padded = jnp.pad(tops_m, width, constant_values=-jnp.inf)
    size = tops_m.shape[axis]
    before, after = (jax.lax.slice_in_dim(padded, start, start + size, axis=axis) for start in (0, 2))
    return pick(pick(before, tops_m), after)


def _at_receivers(supersampled: Surface, values: jax.Array, oversample: int) -> jax.Array:
    return supersampled.crop(values)[oversample // 2 :: oversample, oversample // 2 :: oversample]


def _bands(
    supersampled: Surface, oversample: int, rows_m: jax.Array, cols_m: jax.Array, entry_steps: float, own_m
) -> Bands:
    n = oversample

    def pad(tops_m: jax.Array) -> jax.Array:
        return jnp.pad(tops_m, n, constant_values=-jnp.inf)

    ground_m = None if supersampled.terrain_m is None else _at_receivers(supersampled, supersampled.terrain_m, n)
    return Bands(pad(rows_m), pad(cols_m.T), own_m, ground_m, entry_steps, supersampled, n)


def plain_bands(supersampled: Surface, oversample: int) -> Bands:
    """Return what shadows a map under the rule of `jaxurban.kernels.shadows.sweep` on its supersampled surface."""
    bands = _bands(supersampled, oversample, supersampled.top_m, supersampled.top_m, ENTRY_STEPS, -jnp.inf)
    return replace(bands, has_slabs=supersampled.slabs is not None)


def upper_bands(touched: Surface, oversample: int) -> Bands:
    """Return what certainly shadows no less than the city: a satellite seen under it is seen in truth.

    Args:
      touched: supersampled surface made with ``all_touched``, on which everything reaches the ground.
      oversample: n, odd.

    Raises:
      InputError: an even n.
    """
    _check_odd(oversample)
    tops_m = touched.top_m
    rows_m, cols_m = (_widest(tops_m, axis, jnp.maximum) for axis in (1, 0))
    is_roof = touched.roof_m > 0
    own_m = _at_receivers(touched, jnp.where(is_roof, tops_m, -jnp.inf), oversample)
    return _bands(touched, oversample, rows_m, cols_m, WHOLE_ROW_STEPS, own_m)


def lower_bands(supersampled: Surface, oversample: int) -> Bands:
    """Return what certainly shadows no more than the city: a satellite hidden under it is hidden in truth.

    Args:
      supersampled: supersampled surface, roofs at cell centres. Its slabs shadow nothing here.
      oversample: n, odd.

    Raises:
      InputError: an even n.
    """
    _check_odd(oversample)
    covered_m = _widest(_widest(supersampled.top_m, 0, jnp.minimum), 1, jnp.minimum)
    rows_m, cols_m = (_widest(covered_m, axis, jnp.minimum) for axis in (1, 0))
    return _bands(supersampled, oversample, rows_m, cols_m, WHOLE_ROW_STEPS, -jnp.inf)


def _check_odd(oversample: int) -> None:
    if oversample % 2 == 0:
        raise InputError(f"bounds need an odd oversample (a subcell at each map cell's centre), got {oversample}")


def shadow_heights(bands: Bands, azimuth_rad: float, elevation_rad: float) -> Float[Array, "y x"]:
    """Return the absolute height below which each map cell does not see a source, ``[y, x]``.

    Subcells count as in `jaxurban.kernels.shadows.sweep.shadow_height`; in about the time of the plain map's sweep, as
    rows of subcells are taken n at once, with results at every n-th one.
    """
    n, outer, region = bands.oversample, bands.surface.grid, bands.surface.region
    along_rows = is_along_rows(azimuth_rad)
    first_subcell, num_subcells = (outer.first_row, outer.num_rows) if along_rows else (outer.first_col, outer.num_cols)
    line = band_line(azimuth_rad, elevation_rad, outer.resolution_m, first_subcell // n, num_subcells // n, n)
    first = (region.first_row - outer.first_row) // n, (region.first_col - outer.first_col) // n
    shape = region.num_rows // n, region.num_cols // n
    if along_rows:
        shadow_m = band_shadow_height(bands.along_rows, line, bands.entry_steps, first, per_band=n, shape=shape)
    else:
        shadow_m = band_shadow_height(
            bands.along_cols, line, bands.entry_steps, first[::-1], per_band=n, shape=shape[::-1]
        ).T
    return jnp.maximum(shadow_m, bands.own_m)


def visibility_at_centres(
    bands: Bands, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, altitudes_m: ArrayLike
) -> UInt[Array, "W A y x"]:
    """Return which satellites are seen from each map cell, as bits, from the supersampled surface.

    As `jaxurban.metrics.visibility.visibility` says it.

    Args:
      bands: `plain_bands`, `upper_bands` or `lower_bands`.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = above_horizon(azimuth_rad, elevation_rad)
    height_m = jnp.asarray(altitudes_m, bands.along_rows.dtype)[:, None, None]
    if bands.ground_m is not None:
        height_m = height_m + bands.ground_m
    shape = tuple(size // bands.oversample for size in bands.surface.region.shape)
    words = [jnp.zeros((len(height_m), *shape), jnp.uint32)] * max(1, -(-len(azimuth) // WORD_BITS))
    for s in range(len(azimuth)):
        seen = shadow_heights(bands, azimuth[s], elevation[s]) <= height_m
        words[s // WORD_BITS] |= seen.astype(jnp.uint32) << (s % WORD_BITS)
    seen_words = jnp.stack(words)
    if not bands.has_slabs:
        return seen_words
    on_host, altitudes = np.array(seen_words), np.asarray(altitudes_m, bands.along_rows.dtype)
    return jnp.asarray(without_hidden(on_host, bands.surface, azimuth, elevation, altitudes, bands.oversample))
