"""GPS: how well the satellites seen from each cell fix a position."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, UInt, UInt8

from jaxurban.errors import InputError, nearest_name
from jaxurban.kernels.dop import Geometry, dops_of_words, geometry, unit_vectors
from jaxurban.kernels.occlusion import (
    EAST,
    NORTH,
    SOUTH,
    WEST,
    WORD_BITS,
    Ring,
    digital_line,
    mark_visible,
    mark_visible_within,
)
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.settings import differentiable, holds
from jaxurban.surface import Surface

SATELLITES_STEP = 8  # the DOP program is compiled for 8, 16, 24 ... satellites
BLOCK_CELLS = 2**14  # cells whose DOPs are made at once: what they need in between fits a core's cache
TABLE_SATELLITES = 16  # up to here the maps of all subsets are made once and looked up
MAX_STORED_EPOCHS = 24  # a longer series keeps statistics over time instead of every epoch's maps
SERIES = ("auto", "epochs", "statistics")
RATING_UPPER_GDOP = (1.0, 4.0, 6.0, 8.0, 20.0)  # the paper's table of DOP ratings, Poor above the last


class Rating(IntEnum):
    """The paper's classes of GDOP."""

    IDEAL = 0  # 1 and less
    EXCELLENT = 1  # above 1, up to 4
    GOOD = 2  # up to 6
    MODERATE = 3  # up to 8
    FAIR = 4  # up to 20
    POOR = 5  # above 20, or undetermined


@differentiable("gdop_threshold")
@dataclass(frozen=True)
class GpsParams:
    """Settings of the GPS metric. A pytree whose leaf is the threshold.

    Attributes:
      gdop_threshold: GDOP at and above which m is 0, > 1.
      series: what is kept of several epochs: every one of them (``"epochs"``), statistics over time
        (``"statistics"``, see `jaxurban.metrics.availability`), or statistics above `MAX_STORED_EPOCHS`
        (``"auto"``).
      availability_threshold: m above which a position counts as available, in [0, 1).

    Raises:
      InputError: a value that is none of these.
    """

    gdop_threshold: float = 20.0
    series: Literal["auto", "epochs", "statistics"] = "auto"
    availability_threshold: float = 0.5

    def __post_init__(self) -> None:
        if not holds(self.gdop_threshold, lambda threshold: np.isfinite(threshold) & (threshold > 1)):
            raise InputError(f"gdop_threshold must be a number above 1 (such as 20), got {self.gdop_threshold}")
        if self.series not in SERIES:
            hint = nearest_name(str(self.series), SERIES)
            raise InputError(f"gps series must be one of {', '.join(SERIES)}, got {self.series!r}{hint}")
        if not 0 <= self.availability_threshold < 1:
            raise InputError(
                f"availability_threshold must be a value of m from 0 to below 1, got {self.availability_threshold}"
            )

    def keeps_epochs(self, num_epochs: int) -> bool:
        """Return whether the maps of every epoch are kept, not statistics over them."""
        return self.series == "epochs" or (self.series == "auto" and num_epochs <= MAX_STORED_EPOCHS)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsMaps:
    """GPS maps of one epoch. ``C`` stands for any axes of cells.

    Inside obstacles m and num_visible are 0 and the DOPs inf.

    Attributes:
      m: the metric, 0 to 1.
      gdop, pdop, hdop, vdop, tdop: dilutions of precision; inf with fewer than four satellites or
        where those seen leave the position undetermined.
      num_visible: satellites seen.
    """

    m: Float[Array, "*C"]
    gdop: Float[Array, "*C"]
    pdop: Float[Array, "*C"]
    hdop: Float[Array, "*C"]
    vdop: Float[Array, "*C"]
    tdop: Float[Array, "*C"]
    num_visible: UInt8[Array, "*C"]


def gps_metric(gdop: Float[Array, "*C"], gdop_threshold: float | Array) -> Float[Array, "*C"]:
    """Return m = (T - min(GDOP, T)) / (T - 1), clipped to [0, 1]; 0 at GDOP = inf.

    Source: the paper's equation of m_gps, its GDOP_cut taken as T = GDOP_thresh. The derivative is 0
    beyond the threshold.
    """
    return jnp.clip((gdop_threshold - jnp.minimum(gdop, gdop_threshold)) / (gdop_threshold - 1), 0, 1)


def rating(gdop: np.ndarray) -> np.ndarray:
    """Return the `Rating` of each GDOP as uint8, in the shape given; upper limits count in."""
    return np.searchsorted(RATING_UPPER_GDOP, gdop, side="left").astype(np.uint8)


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
      min_altitude_m: the lowest altitude asked for, above the ground.
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


def visibility(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike | Sequence[float],
    rings: Sequence[Ring] | None = None,
) -> UInt[Array, "W A y x"]:
    """Return which satellites are seen from each cell's centre, as bits.

    Satellite ``s`` is bit ``s % 32`` of word ``s // 32``. It is seen where its ray clears the roofs
    and, with terrain, the ground; `shadow_height` states how exactly. Inside obstacles the answer is
    that of a receiver in a shaft with no walls of its own.

    Args:
      surface: roofs and terrain; what stands outside it shadows nothing.
      azimuth_rad: ``[S]`` clockwise from grid north.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.
      rings: ``[S]`` what the grids around the region hand on, by satellite; the surface's own margin is
        not looked at then.

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float)
    if np.any(elevation < 0):
        raise InputError(
            f"elevation_rad holds a satellite {-math.degrees(elevation.min()):.1f} degrees below the horizon: "
            "give those at or above the elevation mask only"
        )
    region = surface.region
    rows, cols = surface.window
    grid, top_m = surface.grid, surface.top_m
    if rings is not None:
        grid, top_m = region.padded(1, 1, 1, 1), surface.crop(top_m)
    altitudes = jnp.asarray(altitudes_m, surface.roof_m.dtype)
    ground_m = None if surface.terrain_m is None else surface.crop(surface.terrain_m)
    num_words = max(1, -(-len(azimuth) // WORD_BITS))
    lines = [
        digital_line(*angles, grid.resolution_m, grid.first_row, grid.first_col, grid.shape)
        for angles in zip(azimuth, elevation, strict=True)
    ]
    words = jnp.zeros((num_words, *altitudes.shape, *region.shape), jnp.uint32)
    if rings is not None:
        for s, (line, ring) in enumerate(zip(lines, rings, strict=True)):
            words = mark_visible_within(words, top_m, ground_m, altitudes, line, s, ring)
        return words
    has_x64 = jnp.result_type(float) == jnp.float64

    def mark_all(headings: tuple[int, int], words: Array, top_m: Array, ground_m: Array | None, cell: tuple) -> Array:
        with jax.enable_x64(has_x64):  # a new thread knows only the global setting
            for s, line in enumerate(lines):
                if line.heading in headings:
                    words = mark_visible(words, top_m, ground_m, altitudes, line, s, cell)
        return words

    # Lines that head east or west are swept on transposed arrays, made once; the two kinds at the same time.
    turned = words.mT, top_m.T, None if ground_m is None else ground_m.T, (cols.start, rows.start)
    with ThreadPoolExecutor(2) as threads:
        along_rows = threads.submit(mark_all, (NORTH, SOUTH), words, top_m, ground_m, (rows.start, cols.start))
        along_cols = threads.submit(mark_all, (EAST, WEST), *turned)
    return along_rows.result() | along_cols.result().mT


@jax.jit
def _computed(words: UInt[Array, "W ..."], satellites: Geometry, gdop_threshold: float | Array) -> GpsMaps:
    """Return the maps of the satellites seen, made block by block of cells."""
    shape = words.shape[1:]
    size = math.prod(shape)
    num = max(size, BLOCK_CELLS)
    flat = jnp.pad(words.reshape(len(words), -1), ((0, 0), (0, num - size)))  # less than a block becomes one

    def fill(block: Array, maps: list[Array]) -> list[Array]:
        start = jnp.minimum(block * BLOCK_CELLS, num - BLOCK_CELLS)  # the last block laps over the one before
        cells = lax.dynamic_slice_in_dim(flat, start, BLOCK_CELLS, axis=1)
        dops = dops_of_words(satellites, cells)
        num_visible = jnp.sum(lax.population_count(cells), axis=0).astype(jnp.uint8)
        found = [gps_metric(dops.gdop, gdop_threshold), *dops, num_visible]
        return [lax.dynamic_update_slice(old, new, (start,)) for old, new in zip(maps, found, strict=True)]

    empty = [*[jnp.zeros(num, satellites.basis.dtype)] * 6, jnp.zeros(num, jnp.uint8)]
    maps = lax.fori_loop(0, -(-num // BLOCK_CELLS), fill, empty)
    return GpsMaps(*(values[:size].reshape(shape) for values in maps))


@dataclass(frozen=True)
class Epoch:
    """The satellites of one epoch, made ready to turn visibility words into maps.

    Attributes:
      satellites: their geometry.
      table: the maps of every subset of up to `TABLE_SATELLITES` satellites, by its word: a city has
        far more cells than subsets. None for more satellites.
      gdop_threshold: of the metric.
    """

    satellites: Geometry
    table: GpsMaps | None
    gdop_threshold: float

    @classmethod
    def of(cls, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, params: GpsParams) -> "Epoch":
        """Return the epoch of satellites at ``[S]`` azimuths and elevations."""
        directions = unit_vectors(azimuth_rad, elevation_rad)
        satellites = geometry(directions, multiple_of=SATELLITES_STEP)
        table = None
        if len(directions) <= TABLE_SATELLITES:
            num = max(BLOCK_CELLS, 2 ** len(directions))
            subsets = jnp.arange(num, dtype=jnp.uint32)[None]
            table = _computed(subsets, satellites, params.gdop_threshold)
        return cls(satellites, table, params.gdop_threshold)

    def maps(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> GpsMaps:
        """Return the maps of the satellites seen; inside obstacles none is."""
        words = jnp.where(is_obstacle, jnp.uint32(0), words)
        if self.table is None:
            return _computed(words, self.satellites, self.gdop_threshold)
        return _looked_up(self.table, words[0])

    def m(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> Float[Array, "*C"]:
        """Return the metric alone."""
        if self.table is None:
            return self.maps(words, is_obstacle).m
        return _looked_up(self.table.m, jnp.where(is_obstacle, jnp.uint32(0), words[0]))


@jax.jit
def _looked_up(table, index: UInt[Array, "..."]):
    """Return the entries of a table (or of each of a tree of tables) at ``index``."""
    return jax.tree.map(lambda values: values[index], table)


def compute_gps(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike,
    params: GpsParams | None = None,
) -> GpsMaps:
    """Return the GPS maps of the region at every altitude, for one epoch, ``[A, y, x]``.

    Without satellites m is 0 everywhere. The hard maps have zero derivative in heights.

    Args:
      surface: roofs and terrain of the region and its margin (see `shadow_reach_m`).
      azimuth_rad: ``[S]`` clockwise from grid north, of the satellites at or above the mask.
      elevation_rad: ``[S]`` above the horizon.
      altitudes_m: ``[A]`` heights above the ground.
      params: settings; left out, the paper's.

    Raises:
      InputError: a satellite below the horizon.
    """
    words = visibility(surface, azimuth_rad, elevation_rad, altitudes_m)
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), jnp.asarray(altitudes_m, surface.roof_m.dtype))
    return gps_of_words(words, is_obstacle, azimuth_rad, elevation_rad, params)


def gps_of_words(
    words: UInt[Array, "W A y x"],
    is_obstacle: Bool[Array, "A y x"],
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    params: GpsParams | None = None,
) -> GpsMaps:
    """Return the GPS maps of satellites seen as `visibility` says, from the cells that are no obstacle.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
      is_obstacle: where nobody flies.
      azimuth_rad, elevation_rad: ``[S]`` as for `compute_gps`.
      params: settings; left out, the paper's.
    """
    return Epoch.of(azimuth_rad, elevation_rad, params or GpsParams()).maps(words, is_obstacle)
