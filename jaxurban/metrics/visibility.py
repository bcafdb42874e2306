"""Which satellites each cell sees, and how far away roofs may stand that hide them."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxurban.kernels.dop import Clocks, Geometry, geometry, unit_vectors
from jaxurban.kernels.shadows import blocks, slabs, sweep
from jaxurban.kernels.shadows.sweep import WORD_BITS, Line, Ring, digital_lines, stacked
from jaxurban.metrics.base import AnyArray
from jaxurban.world.grid import Grid
from jaxurban.world.surface import PER_CELL, Slabs, Surface

WHOLE_ROW_STEPS = 0.5  # from a row's middle to where a ray enters it


def shadow_reach_m(
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    max_top_m: float,
    min_altitude_m: float,
    resolution_m: float,
) -> tuple[float, float, float, float]:
    """Return the margins west, south, east, north (metres) that hold every roof able to shadow the region.

    0 on sides without satellites; inf where a satellite on the horizon meets a roof above the altitude.

    Args:
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
      max_top_m: how far the highest roof can stand above the lowest ground.
      min_altitude_m: the lowest altitude of the maps, above the ground.
      resolution_m: side of a cell: one more cell pays for the digital line.
    """
    rise_m = max_top_m - min_altitude_m
    if rise_m <= 0:
        return 0.0, 0.0, 0.0, 0.0
    east, north, up = unit_vectors(azimuth_rad, elevation_rad).T
    toward = np.stack([-east, -north, east, north])
    run_m = np.divide(rise_m * toward, up, out=np.full(toward.shape, np.inf), where=up > 0)
    margins_m = np.where(toward > 0, run_m + resolution_m, 0.0).max(axis=1, initial=0.0)
    west, south, east, north = margins_m.tolist()
    return west, south, east, north


class SkyView(NamedTuple):
    """The satellites of one time over one surface, made ready on the host. ``S`` satellites, some of them to fill up.

    Programs are compiled again for another number of satellites or shape of the surface, not for other satellites.

    Attributes:
      lines: digital line toward each over the surface's grid, fields stacked along ``S``.
      satellites: their geometry; those that fill up weigh nothing.
      num: how many there are; those behind are never seen.
    """

    lines: Line
    satellites: Geometry
    num: Int[AnyArray, ""]

    @classmethod
    def of(
        cls,
        surface: Surface,
        azimuth_rad: ArrayLike,
        elevation_rad: ArrayLike,
        multiple_of: int = 1,
        clocks: Clocks | None = None,
    ) -> "SkyView":
        """Return the view of satellites at ``[S]`` azimuths (clockwise from grid north) and elevations.

        Args:
          surface: where the roofs lie; its float type becomes that of the DOPs.
          azimuth_rad, elevation_rad: of the satellites at or above the mask; none are one that fills up.
          multiple_of: satellites are filled up to a multiple of this, so that few programs are compiled.
          clocks: of the satellites; left out, all share one.
        """
        angles = np.array([azimuth_rad, elevation_rad], float).reshape(2, -1)
        dtype = np.dtype(surface.roof_m.dtype).type
        satellites = geometry(unit_vectors(*angles), dtype, multiple_of, clocks)
        num = angles.shape[1]
        grid = surface.grid
        filled = np.zeros((2, len(satellites.rows)))
        filled[:, :num] = angles
        place = grid.resolution_m, grid.first_row, grid.first_col, grid.shape
        lines = digital_lines(filled[0], filled[1], *place)
        return cls(stacked(lines), satellites, np.asarray(num, np.int32))


def visible_words(
    surface: Surface, altitudes_m: Float[Array, " A"], sky: SkyView
) -> UInt[Array, "W A y x"]:
    """Return `visibility` of a sky, by JAX; everything may be traced.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      altitudes_m: heights above the ground.
      sky: over this surface.
    """
    rows, cols = surface.window
    window = rows.start, rows.stop, cols.start, cols.stop, 1
    ground_m = None if surface.terrain_m is None else surface.crop(surface.terrain_m)
    height_m = _heights(ground_m, altitudes_m)
    return sweep.visible_words(surface.top_m, height_m, sky.lines, sky.num, window=window)


def _heights(ground_m: AnyArray | None, altitudes_m: AnyArray) -> AnyArray:
    """Return the absolute height of receivers, ``[A, y, x]`` or over flat ground ``[A, 1, 1]``."""
    z_m = altitudes_m[:, None, None]
    return z_m if ground_m is None else ground_m + z_m


def visibility(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike | Sequence[float],
    rings: Sequence[Ring] | None = None,
    every: int = 1,
) -> UInt[np.ndarray, "W A y x"]:
    """Return which satellites are seen from each cell's centre, as bits.

    Satellite ``s`` is bit ``s % 32`` of word ``s // 32``. It is seen where its ray clears the roofs
    and, with terrain, the ground; `shadow_height` states how exactly, and `jaxurban.kernels.shadows.slabs` for what
    hangs. Inside obstacles the result is that of a receiver in a shaft with no walls of its own.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon, none below it.
      altitudes_m: ``[A]`` heights above the ground.
      rings: ``[S]`` what the grids around the region hand on, by satellite; the surface's own margin is
        not looked at then, but for its slabs.
      every: n, of a surface n times finer than the map: the cells are every n-th of the region both ways, from
        ``n // 2`` on. With an odd n they hold the centres of the map's cells; with an even one, whose centres are
        corners of four cells, they lie half a cell northeast of them.
    """
    azimuth = np.asarray(azimuth_rad, float)
    elevation = np.asarray(elevation_rad, float)
    rows, cols = surface.window
    top_m = np.asarray(surface.top_m)
    grid = surface.grid
    ring = None
    first_cell = rows.start, cols.start
    if rings is not None:
        top_m = top_m[rows, cols]
        grid = surface.region
        first_cell = (0, 0)
        ring = Ring(*(np.stack(values) for values in zip(*rings, strict=True)))
    words, receivers = _receivers(surface, altitudes_m, first_cell, len(azimuth), every)
    blocks.mark_visible(words, top_m, receivers, ringed_lines(grid, azimuth, elevation), ring)
    if surface.slabs is not None:
        _hide_behind_slabs(words, surface, surface.slabs, azimuth, elevation, receivers)
    return words


def _receivers(
    surface: Surface,
    altitudes_m: ArrayLike | Sequence[float],
    first_cell: tuple[int, int],
    num_satellites: int,
    every: int,
) -> tuple[UInt[np.ndarray, "W A y x"], blocks.Receivers]:
    """Return words in which nothing is seen yet, and where their receivers stand; arguments as for `visibility`."""
    altitudes = np.asarray(altitudes_m, surface.roof_m.dtype)
    ground_m = None
    if surface.terrain_m is not None:
        ground_m = np.asarray(surface.terrain_m)[surface.window]
    shape = (size // every for size in surface.region.shape)
    num_words = max(1, -(-num_satellites // WORD_BITS))
    words = np.zeros((num_words, len(altitudes), *shape), np.uint32)
    return words, blocks.Receivers(first_cell, every, ground_m, altitudes)


def _hide_behind_slabs(
    words: UInt[np.ndarray, "W A y x"],
    surface: Surface,
    hanging: Slabs,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    receivers: blocks.Receivers,
) -> None:
    """Clear the bits of the satellites that slabs hide; arguments as for `visibility`."""
    region, every = surface.region, receivers.every
    middle = every // 2
    first_row = (region.first_row + middle) * PER_CELL + PER_CELL // 2
    first_col = (region.first_col + middle) * PER_CELL + PER_CELL // 2
    ground_m = np.empty((0, 0), np.float32)
    if receivers.ground_m is not None:
        ground_m = receivers.ground_m[middle::every, middle::every]
    base_m = hanging.ground_m.astype(float)
    slabs.hide_behind_slabs(
        words,
        receivers.altitudes_m,
        slabs.Receivers(first_row, first_col, every * PER_CELL, ground_m),
        (hanging.row, hanging.col),
        (base_m + hanging.floor_m, base_m + hanging.top_m),
        azimuth_rad,
        elevation_rad,
        surface.grid.resolution_m / PER_CELL,
    )


def bounding_visibility(
    surface: Surface,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    altitudes_m: Sequence[float],
    every: int,
    *,
    hides_most: bool,
) -> UInt[np.ndarray, "W A y x"]:
    """Return `visibility` that is certain: under roofs that hide at least, or at most, what the city hides.

    Those that hide most: a ray meets the highest of the three cells of a row that the true ray may cross, from where
    it enters the row. Those that hide least: only cells whose eight neighbours are covered too count, and a ray meets
    the lowest of the three. Who is seen under the first is seen in truth, and who is hidden under the second is hidden
    in truth, but for gaps between outlines narrower than a cell. This holds for flat-topped prisms over the surface's
    terrain, taken as steps. With cells as wide as the map's (``every`` 1) both are valid but wide.

    Args:
      surface: ``every`` times finer than the map. For most: everything reaches the ground, and roofs cover all cells
        that they touch. For least: roofs at the cells' centres, nothing hangs.
      azimuth_rad, elevation_rad, altitudes_m: as for `visibility`.
      every: odd.
      hides_most: which.
    """
    rows, cols = surface.window
    reached = partial(_of_three, np.maximum if hides_most else np.minimum)
    top_m = np.asarray(surface.top_m)
    covered_m = top_m if hides_most else reached(reached(top_m, axis=0), axis=1)
    first_cell = rows.start, cols.start
    words, receivers = _receivers(surface, altitudes_m, first_cell, len(azimuth_rad), every)
    blocks.mark_visible(
        words,
        reached(covered_m, axis=1),
        receivers,
        ringed_lines(surface.grid, azimuth_rad, elevation_rad),
        entry_steps=WHOLE_ROW_STEPS,
        turned_top_m=reached(covered_m, axis=0),
    )
    if hides_most:  # the roof over the receiver's own cell hides all
        middles = slice(every // 2, None, every)
        own_m = np.where(np.asarray(surface.roof_m) > 0, top_m, -np.inf)[rows, cols]
        ground_m = receivers.ground_m
        own_ground_m = None if ground_m is None else ground_m[middles, middles]
        words *= own_m[middles, middles] <= _heights(own_ground_m, receivers.altitudes_m)
    return words


def _of_three(extreme: np.ufunc, values: np.ndarray, axis: int) -> np.ndarray:
    """Return an extreme of every cell and those beside it along an axis, -inf beyond.

    SciPy's filter takes six times longer.
    """
    along = np.moveaxis(values, axis, 0)
    grown = np.pad(along, ((1, 1), (0, 0)), constant_values=-np.inf)
    found = extreme(extreme(grown[:-2], along), grown[2:])
    return np.moveaxis(found, 0, axis)


def distinct_choices(
    words: UInt[AnyArray, "W ..."], is_obstacle: Bool[AnyArray, "..."]
) -> tuple[UInt[np.ndarray, "W P"], Int[np.ndarray, "..."]]:
    """Return every choice of satellites that some cell sees once, and the number of each cell's.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
      is_obstacle: cells that see no satellite, whatever the words say.
    """
    choices: list[np.ndarray] = []
    number = np.zeros(1, np.int64)
    for word in words:
        of_word, seen = pd.factorize(np.where(is_obstacle, np.uint32(0), word).reshape(-1))
        pairs = np.arange(len(seen))  # of an earlier choice and one of this word
        if choices:
            of_word, pairs = pd.factorize(number * len(seen) + of_word)
        choices = [earlier[pairs // len(seen)] for earlier in choices] + [seen[pairs % len(seen)]]
        number = of_word
    return np.stack(choices), number.reshape(words.shape[1:])


def ringed_lines(grid: Grid, azimuth_rad: np.ndarray, elevation_rad: np.ndarray) -> Line:
    """Return the digital line toward each satellite over a grid grown by one cell on each side, stacked."""
    place = grid.resolution_m, grid.first_row - 1, grid.first_col - 1
    grown = grid.num_rows + 2, grid.num_cols + 2
    return stacked(digital_lines(azimuth_rad, elevation_rad, *place, grown))
