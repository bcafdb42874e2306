"""Which satellites each cell sees, and how far away roofs may stand that hide them."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxurban.kernels.dop import Clocks, Geometry, geometry, unit_vectors
from jaxurban.kernels.shadows import blocks, sweep
from jaxurban.kernels.shadows.sweep import WORD_BITS, DigitalLine, Ring, digital_lines, stacked
from jaxurban.world.grid import Grid
from jaxurban.world.surface import PER_CELL, AnyArray, Slabs, Surface

WHOLE_ROW_STEPS = 0.5  # from a row's middle to where a ray enters it


def shadow_reach_m(
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    max_top_m: float,
    min_altitude_m: float,
    resolution_m: float,
) -> tuple[float, float, float, float]:
    """Return the margins west, south, east, north (metres) that hold every roof able to shadow the region.

    A margin is 0 on a side without satellites, and inf where a satellite on the horizon meets a roof above the maps.

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
    toward_east, toward_north, up = unit_vectors(azimuth_rad, elevation_rad).T
    # [4, S]: how much of the unit vector to each satellite points west, south, east and north.
    toward = np.stack([-toward_east, -toward_north, toward_east, toward_north])
    run_m = np.divide(rise_m * toward, up, out=np.full(toward.shape, np.inf), where=up > 0)
    margins_m = np.where(toward > 0, run_m + resolution_m, 0.0).max(axis=1, initial=0.0)
    west_m, south_m, east_m, north_m = margins_m.tolist()
    return west_m, south_m, east_m, north_m


class SkyView(NamedTuple):
    """The satellites of one time over one surface, made ready on the host.

    ``S`` counts the satellites and those without effect that follow them, which round their number up.

    Programs are compiled again for another number of satellites or shape of the surface, not for other satellites.

    Attributes:
      lines: digital line toward each over the surface's grid, fields stacked along ``S``.
      satellites: their geometry, in which those without effect weigh nothing.
      num: number of true satellites; those from this one on are without effect and never seen.
    """

    lines: DigitalLine
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
        """Return the view of the satellites at or above the elevation mask over a surface.

        Args:
          surface: where the roofs lie; their float type becomes that of the DOPs.
          azimuth_rad: ``[num]`` clockwise from grid north; may be empty.
          elevation_rad: ``[num]`` above the horizon.
          multiple_of: satellites without effect are added up to a multiple of this number, and up to one at least, so
            that few programs are compiled.
          clocks: which receiver clock each satellite has; left out, all share one.
        """
        azimuth, elevation = np.array([azimuth_rad, elevation_rad], float).reshape(2, -1)
        num = len(azimuth)
        dtype = np.dtype(surface.roof_m.dtype).type
        satellites = geometry(unit_vectors(azimuth, elevation), dtype, multiple_of, clocks)

        # The satellites without effect get a line due north: any would do, as none of its results is read.
        padding = 0, len(satellites.rows) - num
        grid = surface.grid
        lines = digital_lines(
            np.pad(azimuth, padding),
            np.pad(elevation, padding),
            grid.resolution_m,
            grid.first_row,
            grid.first_col,
            grid.shape,
        )
        return cls(stacked(lines), satellites, np.asarray(num, np.int32))


def visible_words(
    surface: Surface, altitudes_m: Float[Array, " A"], sky: SkyView
) -> UInt[Array, "W A y x"]:
    """Return which satellites are seen from each cell of the region, as bits (see `visibility`), computed by JAX.

    Every argument may be traced. There is no gradient, as the result holds whole numbers.

    Args:
      surface: roofs and terrain, without slabs; what stands outside it shadows nothing.
      altitudes_m: ``[A]`` heights of the receivers above the ground.
      sky: the satellites over this surface.
    """
    surface = surface.of_hiding()
    height_m = _heights(surface.crop(surface.terrain_m), altitudes_m)
    return sweep.words_along_lines(
        surface.top_m, height_m, sky.lines, sky.num, window=surface.window_ends
    )


def traced_shadows(surface: Surface, sky: SkyView) -> Float[Array, "S y x"]:
    """Return `shadows_over` by JAX, with satellites without effect too; arguments may be traced."""
    surface = surface.of_hiding()
    top_m = sweep.heights_in_rounds(surface.top_m, sky.lines, surface.window_ends)
    return _above_ground(top_m, surface.crop(surface.terrain_m))


def _above_ground(top_m: Any, ground_m: Any) -> Any:
    """Return heights above the ground of absolute ones; the ground is None where it is flat, at 0."""
    return top_m if ground_m is None else top_m - ground_m


def _heights(ground_m: AnyArray | None, altitudes_m: AnyArray) -> AnyArray:
    """Return the absolute height of receivers, ``[A, y, x]`` or over flat ground ``[A, 1, 1]``, in metres.

    Args:
      ground_m: ``[y, x]`` elevation of the ground; None where it is flat, at 0.
      altitudes_m: ``[A]`` heights of the receivers above the ground.
    """
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
    """Return which satellites are seen from each cell's centre, as bits: ``W`` words of 32 satellites each.

    Satellite ``s`` is bit ``s % 32`` of word ``s // 32``. It is seen where its ray clears the roofs
    and, with terrain, the ground; `shadow_height` states how exactly, and `jaxurban.kernels.shadows.slabs` for what
    hangs. Inside obstacles the result is that of a receiver in a shaft whose own walls hide nothing.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon, none below it.
      altitudes_m: ``[A]`` heights above the ground.
      rings: ``[S]`` the shadows that the grids around the region hand on, by satellite. The surface's own margin then
        counts only for its slabs. Left out, the margin's roofs cast the shadows that reach the region.
      every: n, where the surface is n times finer than the map: receivers stand in every n-th cell of the region both
        ways, from ``n // 2`` on. With an odd n these cells hold the centres of the map's cells; with an even one,
        whose centres are corners of four cells, they lie half a cell northeast of them.
    """
    surface = surface.of_hiding()
    azimuth = np.asarray(azimuth_rad, float)
    elevation = np.asarray(elevation_rad, float)
    top_m, first_cell, lines, ring = _cast_over(surface, azimuth, elevation, rings)
    words, receivers = _receivers(surface, altitudes_m, first_cell, len(azimuth), every)
    blocks.mark_visible(words, top_m, receivers, lines, ring)
    if surface.slabs is not None:
        _hide_behind_slabs(words, surface, surface.slabs, azimuth, elevation, receivers)
    return words


def shadows_over(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    rings: Sequence[Ring] | None = None,
    every: int = 1,
) -> Float[np.ndarray, "S y x"]:
    """Return how high above the ground the shadow of each satellite reaches, in metres.

    It is -inf where nothing stands toward the satellite. Arguments are those of `visibility`; the surface has no slabs.
    """
    surface = surface.of_hiding()
    azimuth = np.asarray(azimuth_rad, float)
    elevation = np.asarray(elevation_rad, float)
    top_m, first_cell, lines, ring = _cast_over(surface, azimuth, elevation, rings)
    region = surface.region
    shape = region.num_rows // every, region.num_cols // every
    receivers = blocks.Receivers(first_cell, every, None, np.empty(0, top_m.dtype))
    shadow_m = blocks.shadows_on_receivers(top_m, shape, receivers, lines, ring)
    own = slice(every // 2, None, every)
    ground_m = surface.crop(surface.terrain_m)
    return _above_ground(shadow_m, None if ground_m is None else np.asarray(ground_m)[own, own])


def _cast_over(
    surface: Surface,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    rings: Sequence[Ring] | None,
) -> tuple[np.ndarray, tuple[int, int], DigitalLine, Ring | None]:
    """Return what shadows are cast over: tops, the region's first cell among them, lines, and what is handed on.

    They are cast over the surface with its margin or, with rings, over the region alone. The four sides of all rings
    are stacked by side, each along ``S``. Arguments are those of `visibility`.
    """
    rows, cols = surface.window
    top_m = np.asarray(surface.top_m)
    if rings is None:
        lines = ringed_lines(surface.grid, azimuth_rad, elevation_rad)
        return top_m, (rows.start, cols.start), lines, None
    ring = Ring(*(np.stack(values) for values in zip(*rings, strict=True)))
    lines = ringed_lines(surface.region, azimuth_rad, elevation_rad)
    return top_m[rows, cols], (0, 0), lines, ring


def _receivers(
    surface: Surface,
    altitudes_m: ArrayLike | Sequence[float],
    first_cell: tuple[int, int],
    num_satellites: int,
    every: int,
) -> tuple[UInt[np.ndarray, "W A y x"], blocks.Receivers]:
    """Return words in which no satellite is seen yet, and where the receivers stand that they are for.

    Args:
      surface, altitudes_m, every: as for `visibility`.
      first_cell: row and column of the region's southwest cell in the grid that shadows are cast over.
      num_satellites: S; 32 of them share a word.
    """
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
    """Clear, in place, the bits of ``words`` for the satellites that slabs hide.

    Args:
      words: the satellites that are seen past roofs and the ground.
      surface: whose region the receivers stand in.
      hanging: all slabs that can shadow the region.
      azimuth_rad, elevation_rad: ``[S]`` as for `visibility`.
      receivers: where the receivers of the words stand.
    """
    from jaxurban.kernels.shadows import slabs  # imported here: it brings Numba

    region = surface.region
    every = receivers.every
    # The slabs' kernel counts subcells, `PER_CELL` along a cell's side; receivers stand in the middle of theirs.
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
        slabs.SlabReceivers(first_row, first_col, every * PER_CELL, ground_m),
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
    """Return the `visibility` words under roofs that hide at least, or at most, what the city truly hides.

    With roofs that hide most, a ray meets the highest of the three cells of a row that the true ray may cross, from
    where it enters the row: a satellite that is seen then is seen in truth. With roofs that hide least, only cells
    whose eight neighbours are covered too count, and a ray meets the lowest of the three cells: a satellite that is
    hidden then is hidden in truth, but for gaps between outlines narrower than a cell. This holds for flat-topped
    prisms over the surface's terrain, taken as steps. With cells as wide as the map's (``every`` 1) both results are
    valid but far apart.

    Args:
      surface: ``every`` times finer than the map. To hide most, everything in it reaches the ground, and roofs cover
        all cells that they touch. To hide least, roofs cover the cells whose centres they cover, and nothing hangs.
      azimuth_rad, elevation_rad, altitudes_m: as for `visibility`.
      every: how many times finer the surface is; odd.
      hides_most: True for roofs that hide most, False for roofs that hide least.
    """
    surface = surface.of_hiding()
    rows, cols = surface.window
    extreme_of_three = partial(_of_three, np.maximum if hides_most else np.minimum)
    top_m = np.asarray(surface.top_m)
    # To hide least, a cell is as low as the lowest of its eight neighbours.
    covered_m = top_m if hides_most else extreme_of_three(extreme_of_three(top_m, axis=0), axis=1)
    first_cell = rows.start, cols.start
    words, receivers = _receivers(surface, altitudes_m, first_cell, len(azimuth_rad), every)
    # Rays that are followed row by row meet one of three cells of a row, the others (turned) three of a column.
    blocks.mark_visible(
        words,
        extreme_of_three(covered_m, axis=1),
        receivers,
        ringed_lines(surface.grid, azimuth_rad, elevation_rad),
        entry_steps=WHOLE_ROW_STEPS,
        turned_top_m=extreme_of_three(covered_m, axis=0),
    )

    # The roof over the receiver's own cell hides all satellites: a product with False clears the words.
    if hides_most:
        middles = slice(every // 2, None, every)
        own_m = np.where(np.asarray(surface.roof_m) > 0, top_m, -np.inf)[rows, cols]
        ground_m = receivers.ground_m
        own_ground_m = None if ground_m is None else ground_m[middles, middles]
        words *= own_m[middles, middles] <= _heights(own_ground_m, receivers.altitudes_m)
    return words


def _of_three(extreme: np.ufunc, values: np.ndarray, axis: int) -> np.ndarray:
    """Return the extreme of each cell and its two neighbours along an axis, ``[Y, X]`` as the values.

    Beyond the border the values count as -inf. SciPy's filter does the same in six times the time.

    Args:
      extreme: `numpy.maximum` or `numpy.minimum`.
      values: ``[Y, X]``.
      axis: 0 for the neighbours south and north, 1 for those west and east.
    """
    centre = np.moveaxis(values, axis, 0)
    grown = np.pad(centre, ((1, 1), (0, 0)), constant_values=-np.inf)
    extremes = extreme(extreme(grown[:-2], centre), grown[2:])
    return np.moveaxis(extremes, 0, axis)


def distinct_choices(
    words: UInt[AnyArray, "W ..."], is_obstacle: Bool[AnyArray, "..."]
) -> tuple[UInt[np.ndarray, "W P"], Int[np.ndarray, "..."]]:
    """Return the ``P`` distinct choices of satellites that cells see, and which of these choices each cell sees.

    Args:
      words: ``[W, ...]`` satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells after the first.
      is_obstacle: cells that see no satellite, whatever the words say.

    Returns:
      The choices as words, each choice once, and for each cell the number of its choice, 0 to ``P - 1``.
    """
    import pandas as pd

    choices: list[np.ndarray] = []  # by the words so far: an array of P for each word
    number = np.zeros(1, np.int64)  # of each cell's choice
    for word in words:
        new_number, values = pd.factorize(np.where(is_obstacle, np.uint32(0), word).reshape(-1))
        # A choice by one more word is a pair: number of the earlier choice x len(values) + number of the word's value.
        pairs = np.arange(len(values))
        if choices:
            new_number, pairs = pd.factorize(number * len(values) + new_number)
        choices = [earlier[pairs // len(values)] for earlier in choices]
        choices.append(values[pairs % len(values)])
        number = new_number
    return np.stack(choices), number.reshape(words.shape[1:])


def ringed_lines(grid: Grid, azimuth_rad: np.ndarray, elevation_rad: np.ndarray) -> DigitalLine:
    """Return the digital line toward each satellite over a grid grown by one cell on each side, stacked along ``S``.

    Args:
      grid: the grid, not grown.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
    """
    grown = grid.padded(1, 1, 1, 1)
    lines = digital_lines(
        azimuth_rad,
        elevation_rad,
        grown.resolution_m,
        grown.first_row,
        grown.first_col,
        grown.shape,
    )
    return stacked(lines)
