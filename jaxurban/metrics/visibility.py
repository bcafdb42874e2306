"""Which satellites each cell sees, and how far away roofs may stand that hide them."""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxurban.errors import InputError
from jaxurban.kernels.dop import Clocks, Geometry, geometry, unit_vectors
from jaxurban.kernels.shadows.doubling import (
    KernelShape,
    hand_on_at_once,
    kernel_shape,
    num_passes,
    shadow_heights_at_once,
    words_of,
)
from jaxurban.kernels.shadows.slabs import Receivers, hide_behind_slabs
from jaxurban.kernels.shadows.soft import shadow_heights
from jaxurban.kernels.shadows.sweep import WORD_BITS, Line, Ring, digital_lines, stacked
from jaxurban.kernels.shadows.sweep_cpu import hand_on, mark_visible
from jaxurban.metrics.base import AnyArray, in_type, zeros_for_jax
from jaxurban.world.grid import Grid
from jaxurban.world.surface import PER_CELL, Surface

LEAST_DROP_M = 1e-9  # a ray on the horizon never climbs above a roof


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
    margins_m = [0.0, 0.0, 0.0, 0.0]
    if rise_m <= 0:
        return 0.0, 0.0, 0.0, 0.0
    for east, north, up in unit_vectors(azimuth_rad, elevation_rad):
        for side, toward in enumerate((-east, -north, east, north)):
            if toward > 0:
                run_m = rise_m * toward / up if up > 0 else math.inf
                margins_m[side] = max(margins_m[side], run_m + resolution_m)
    west, south, east, north = margins_m
    return west, south, east, north


def above_horizon(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths and elevations of satellites as float64.

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float)
    if np.any(elevation < 0):
        raise InputError(
            f"elevation_rad holds a satellite {-math.degrees(elevation.min()):.1f} degrees below the horizon: "
            "give those at or above the elevation mask only"
        )
    return azimuth, elevation


class SkyView(NamedTuple):
    """The satellites of one time over one surface, made ready on the host. ``S`` satellites, some of them to fill up.

    Programs are compiled anew for another number of satellites or shape of the surface, not for other satellites.

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

        Raises:
          InputError: a satellite below the horizon.
        """
        azimuth, elevation = above_horizon(np.atleast_1d(azimuth_rad), np.atleast_1d(elevation_rad))
        dtype = np.dtype(surface.roof_m.dtype).type
        satellites = geometry(unit_vectors(azimuth, elevation), dtype, multiple_of, clocks)
        num, grid = len(azimuth), surface.grid
        filled = np.zeros((2, len(satellites.rows)))
        filled[:, :num] = azimuth, elevation
        place = grid.resolution_m, grid.first_row, grid.first_col, grid.shape
        lines = digital_lines(filled[0], filled[1], *place)
        return cls(stacked(lines), satellites, np.asarray(num, np.int32))


def visible_words(surface: Surface, altitudes_m: Float[Array, " A"], sky: SkyView) -> UInt[Array, "W A y x"]:
    """Return `jaxurban.metrics.visibility.visibility` of a sky, by the shape for the platform that it is compiled for.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      altitudes_m: heights above the ground.
      sky: over this surface.
    """
    rows, cols = surface.window
    shadows_m = shadow_heights(surface.top_m, sky.lines, (rows.start, rows.stop, cols.start, cols.stop, 1))
    is_there = jnp.arange(len(shadows_m)) < sky.num
    shadows_m = jnp.where(is_there[:, None, None], shadows_m, jnp.inf)
    return words_of(shadows_m, None if surface.terrain_m is None else surface.crop(surface.terrain_m), altitudes_m)


@partial(jax.jit, static_argnames=("passes", "window"))
def _doubled_words(
    top_m: Array,
    ground_m: Array | None,
    altitudes_m: Array,
    lines: Line,
    rings: Ring | None,
    *,
    passes: int,
    window: tuple[int, int, int, int] | None,
) -> Array:
    """Return visibility words ``[W, A, y, x]`` of stacked lines, on a window (or all) of the cells of ``top_m``."""
    shadows_m = shadow_heights_at_once(top_m, lines, passes=passes, rings=rings)
    if window is not None:
        shadows_m = shadows_m[:, window[0] : window[1], window[2] : window[3]]
    return words_of(shadows_m, ground_m, altitudes_m)


def handed_on(
    top_m: Float[Array, "Y X"], lines: Sequence[Line], rings: Sequence[Ring], shape: KernelShape | None = None
) -> Ring:
    """Return what a grid hands on to its neighbours, as `jaxurban.kernels.shadows.sweep_cpu.hand_on` says.

    Args:
      top_m: absolute height of roofs and bare ground.
      lines: ``[S]`` for the grid grown by one cell on each side.
      rings: ``[S]`` what the grids around this one hand on.
      shape: as in `visibility`.
    """
    if (shape or kernel_shape()) == "doubling":
        passes = num_passes(max(top_m.shape) + 2)
        return hand_on_at_once(top_m, stacked(lines), _stacked_rings(rings), passes=passes)
    return hand_on(np.asarray(top_m), stacked(lines), _stacked_rings(rings))


def _stacked_rings(rings: Sequence[Ring]) -> Ring:
    return Ring(*(np.stack(values) for values in zip(*rings, strict=True)))


def visibility(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike | Sequence[float],
    rings: Sequence[Ring] | None = None,
    shape: KernelShape | None = None,
) -> UInt[Array, "W A y x"]:
    """Return which satellites are seen from each cell's centre, as bits.

    Satellite ``s`` is bit ``s % 32`` of word ``s // 32``. It is seen where its ray clears the roofs
    and, with terrain, the ground; `shadow_height` states how exactly, and `jaxurban.kernels.shadows.slabs` for what
    hangs. Inside obstacles the result is that of a receiver in a shaft with no walls of its own.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.
      rings: ``[S]`` what the grids around the region hand on, by satellite; the surface's own margin is
        not looked at then, but for its slabs.
      shape: of the kernel: ``"sweep"`` or ``"doubling"`` (see `jaxurban.kernels.shadows.doubling`); left out, the one
        for JAX's platform.

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = above_horizon(azimuth_rad, elevation_rad)
    altitudes = in_type(altitudes_m, surface.roof_m.dtype)
    if len(azimuth) and (shape or kernel_shape()) == "doubling":
        doubled = _doubled(surface, azimuth, elevation, altitudes, rings)
        return (
            doubled
            if surface.slabs is None
            else jax.device_put(without_hidden(np.array(doubled), surface, azimuth, elevation, altitudes))
        )
    rows, cols = surface.window
    words = zeros_for_jax((max(1, -(-len(azimuth) // WORD_BITS)), *altitudes.shape, *surface.region.shape), np.uint32)
    if not len(azimuth):
        return jax.device_put(words)
    top_m, grid, first_cell = np.asarray(surface.top_m), surface.grid, (rows.start, cols.start)
    if rings is not None:
        top_m, grid, first_cell = np.ascontiguousarray(top_m[rows, cols]), surface.region, (0, 0)
    ground_m = None if surface.terrain_m is None else np.ascontiguousarray(np.asarray(surface.terrain_m)[rows, cols])
    lines = stacked(lines_over(grid.padded(1, 1, 1, 1), azimuth, elevation))
    ring = None if rings is None else _stacked_rings(rings)
    mark_visible(words, top_m, ground_m, np.asarray(altitudes), lines, first_cell, ring)
    return jax.device_put(without_hidden(words, surface, azimuth, elevation, altitudes))


def without_hidden(
    words: UInt[np.ndarray, "W A y x"],
    surface: Surface,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    altitudes_m: AnyArray,
    every: int = 1,
) -> UInt[np.ndarray, "W A y x"]:
    """Return visibility words, altered, without the satellites that the surface's slabs hide.

    Args:
      words: as `visibility` gives them, on every ``every``-th cell of the region both ways, from ``every // 2`` on.
      surface: whose slabs count.
      azimuth_rad, elevation_rad: ``[S]`` of the satellites.
      altitudes_m: ``[A]`` heights above the ground.
      every: see above.
    """
    if (slabs := surface.slabs) is None:
        return words
    region, middle = surface.region, every // 2
    first_row, first_col = (
        (first + middle) * PER_CELL + PER_CELL // 2 for first in (region.first_row, region.first_col)
    )
    ground_m = np.empty((0, 0), np.float32)
    if surface.terrain_m is not None:
        rows, cols = surface.window
        ground_m = np.asarray(surface.terrain_m)[rows, cols][middle::every, middle::every]
    hide_behind_slabs(
        words,
        np.asarray(altitudes_m),
        Receivers(first_row, first_col, every * PER_CELL, ground_m),
        (slabs.row, slabs.col),
        (slabs.ground_m.astype(float) + slabs.floor_m, slabs.ground_m.astype(float) + slabs.top_m),
        azimuth_rad,
        elevation_rad,
        surface.grid.resolution_m / PER_CELL,
    )
    return words


def distinct_choices(
    words: UInt[AnyArray, "W ..."], is_obstacle: Bool[AnyArray, "..."]
) -> tuple[UInt[np.ndarray, "W P"], Int[np.ndarray, "..."]]:
    """Return every choice of satellites that some cell sees once, and the number of each cell's.

    Cells that see what the one before them sees are not sorted.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
      is_obstacle: cells that see no satellite, whatever the words say.
    """
    flat = np.where(is_obstacle, np.uint32(0), words).reshape(len(words), -1)
    is_new = np.append(True, (flat[:, 1:] != flat[:, :-1]).any(axis=0))[: flat.shape[1]]
    runs = flat[:, is_new]
    number, first = np.zeros(runs.shape[1], np.int64), np.zeros(0, np.int64)
    for word in runs:
        _, first, number = np.unique(number << WORD_BITS | word, return_index=True, return_inverse=True)
    return runs[:, first], number.astype(np.int32)[np.cumsum(is_new) - 1].reshape(words.shape[1:])


def lines_over(grid: Grid, azimuth: np.ndarray, elevation: np.ndarray) -> list[Line]:
    """Return the digital line toward each satellite over a grid."""
    return digital_lines(azimuth, elevation, grid.resolution_m, grid.first_row, grid.first_col, grid.shape)


def _doubled(
    surface: Surface, azimuth: np.ndarray, elevation: np.ndarray, altitudes: AnyArray, rings: Sequence[Ring] | None
) -> Array:
    """Return the words by doubling; arguments as in `visibility`."""
    rows, cols = surface.window
    grid, top_m = surface.grid, surface.top_m
    if rings is not None:
        grid, top_m = surface.region.padded(1, 1, 1, 1), surface.crop(top_m)
    ground_m = None if surface.terrain_m is None else surface.crop(surface.terrain_m)
    lines = lines_over(grid, azimuth, elevation)
    ring = None if rings is None else _stacked_rings(rings)
    highest_m = max(float(jnp.max(values)) for values in (top_m, *(ring or ())))
    rise_m = highest_m - float(altitudes.min() + (0 if ground_m is None else jnp.min(ground_m)))
    least_drop_m = max(min(float(line.drop_m) for line in lines), LEAST_DROP_M)
    passes = num_passes(min(max(grid.shape), rise_m / least_drop_m + 2))
    window = None if rings is not None else (rows.start, rows.stop, cols.start, cols.stop)
    return _doubled_words(top_m, ground_m, altitudes, stacked(lines), ring, passes=passes, window=window)
