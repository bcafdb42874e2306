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

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, UInt

from jaxurban.io.read.rasterise import build_surface
from jaxurban.kernels.shadows.sweep import ENTRY_STEPS, WORD_BITS, stacked
from jaxurban.kernels.shadows.sweep_cpu import mark_visible
from jaxurban.metrics.base import AnyArray
from jaxurban.metrics.visibility import above_horizon, lines_over, without_hidden
from jaxurban.world.city import City
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

WHOLE_ROW_STEPS = 0.5  # from a row's middle to where a ray enters it


def build_supersampled_surface(
    city: City, region: Grid, grid: Grid, oversample: int, all_touched: bool = False
) -> Surface:
    """Return the city as rasters n times finer than the map's ``region`` and its surrounding ``grid``.

    Raises:
      InputError: as for `build_surface`.
    """
    without_blocks = replace(city, blocks=None)
    grids = region.refined(oversample), grid.refined(oversample)
    supersampled = build_surface(without_blocks, *grids, all_touched=all_touched)
    return replace(supersampled, roof_touched_m=None)


@dataclass(frozen=True)
class Bands:
    """What shadows the cells of a map. ``Y, X`` subcells, ``y, x`` map cells.

    Attributes:
      along_rows: ``[Y, X]`` absolute height of tops, for rays that go from row to row.
      along_cols: ``[Y, X]`` the same for rays that go from column to column.
      own_m: ``[y, x]`` top that hides all below it in the receiver's own cell; None where nothing does.
      entry_steps: share of a step before a row's middle at which a ray meets its roofs.
      surface: the supersampled surface; its slabs shadow too, between floor and top.
      oversample: n.
    """

    along_rows: Float[np.ndarray, "Y X"]
    along_cols: Float[np.ndarray, "Y X"]
    own_m: Float[np.ndarray, "y x"] | None
    entry_steps: float
    surface: Surface
    oversample: int


def _widest(tops_m: np.ndarray, axis: int, pick: Callable) -> np.ndarray:
    """Return the highest (lowest) of each cell and its neighbours along an axis; nothing stands beyond the edge."""
    padded = np.pad(tops_m, [(int(k == axis), int(k == axis)) for k in range(2)], constant_values=-np.inf)
    before, after = (np.take(padded, start + np.arange(tops_m.shape[axis]), axis) for start in (0, 2))
    return pick(pick(before, tops_m), after)


def _at_receivers(supersampled: Surface, values: AnyArray, oversample: int) -> np.ndarray:
    return np.asarray(values)[supersampled.window][oversample // 2 :: oversample, oversample // 2 :: oversample]


def plain_bands(supersampled: Surface, oversample: int) -> Bands:
    """Return what shadows a map under the rule of `jaxurban.kernels.shadows.sweep` on its supersampled surface."""
    tops_m = np.asarray(supersampled.top_m)
    return Bands(tops_m, tops_m, None, ENTRY_STEPS, supersampled, oversample)


def upper_bands(touched: Surface, oversample: int) -> Bands:
    """Return what certainly shadows no less than the city: a satellite seen under it is seen in truth.

    Args:
      touched: supersampled surface made with ``all_touched``, on which everything reaches the ground.
      oversample: n, odd.
    """
    tops_m = np.asarray(touched.top_m)
    rows_m, cols_m = (_widest(tops_m, axis, np.maximum) for axis in (1, 0))
    own_m = _at_receivers(touched, np.where(np.asarray(touched.roof_m) > 0, tops_m, -np.inf), oversample)
    return Bands(rows_m, cols_m, own_m, WHOLE_ROW_STEPS, touched, oversample)


def lower_bands(supersampled: Surface, oversample: int) -> Bands:
    """Return what certainly shadows no more than the city: a satellite hidden under it is hidden in truth.

    Args:
      supersampled: supersampled surface, roofs at cell centres. Its slabs shadow nothing here.
      oversample: n, odd.
    """
    covered_m = _widest(_widest(np.asarray(supersampled.top_m), 0, np.minimum), 1, np.minimum)
    rows_m, cols_m = (_widest(covered_m, axis, np.minimum) for axis in (1, 0))
    return Bands(rows_m, cols_m, None, WHOLE_ROW_STEPS, replace(supersampled, slabs=None), oversample)


def visibility_at_centres(
    bands: Bands, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, altitudes_m: ArrayLike
) -> UInt[np.ndarray, "W A y x"]:
    """Return which satellites are seen from each map cell, as bits, from the supersampled surface.

    As `jaxurban.metrics.visibility.visibility` says it, by Numba wherever JAX computes.

    Args:
      bands: `plain_bands`, `upper_bands` or `lower_bands`.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = above_horizon(azimuth_rad, elevation_rad)
    surface, n, altitudes = bands.surface, bands.oversample, np.asarray(altitudes_m, bands.along_rows.dtype)
    shape = tuple(size // n for size in surface.region.shape)
    words = np.zeros((max(1, -(-len(azimuth) // WORD_BITS)), len(altitudes), *shape), np.uint32)
    rows, cols = surface.window
    ground_m = None if surface.terrain_m is None else np.asarray(surface.terrain_m)[rows, cols]
    mark_visible(
        words,
        bands.along_rows,
        ground_m,
        altitudes,
        stacked(lines_over(surface.grid.padded(1, 1, 1, 1), azimuth, elevation)),
        (rows.start, cols.start),
        every=n,
        entry_steps=bands.entry_steps,
        turned_top_m=bands.along_cols,
    )
    if bands.own_m is not None:
        ground = 0 if surface.terrain_m is None else _at_receivers(surface, surface.terrain_m, n)
        words *= bands.own_m <= altitudes[:, None, None] + ground
    return without_hidden(words, surface, azimuth, elevation, altitudes, n)
