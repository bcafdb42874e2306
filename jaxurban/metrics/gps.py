"""GPS: how well the satellites seen from each cell fix a position."""

import math
from dataclasses import dataclass
from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, UInt, UInt8

from jaxurban.errors import InputError
from jaxurban.kernels.dop import Geometry, dops_of_words, geometry, unit_vectors
from jaxurban.kernels.occlusion import WORD_BITS, digital_line, mark_visible
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.surface import Surface

SATELLITES_STEP = 8  # the DOP program is compiled for 8, 16, 24 ... satellites
BLOCK_CELLS = 2**14  # cells whose DOPs are made at once: what they need in between fits a core's cache
RATING_UPPER_GDOP = (1.0, 4.0, 6.0, 8.0, 20.0)  # the paper's table of DOP ratings, Poor above the last


class Rating(IntEnum):
    """The paper's classes of GDOP."""

    IDEAL = 0  # 1 and less
    EXCELLENT = 1  # above 1, up to 4
    GOOD = 2  # up to 6
    MODERATE = 3  # up to 8
    FAIR = 4  # up to 20
    POOR = 5  # above 20, or undetermined


@dataclass(frozen=True)
class GpsParams:
    """Settings of the GPS metric.

    Attributes:
      gdop_threshold: GDOP at and above which m is 0, > 1.
    """

    gdop_threshold: float = 20.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.gdop_threshold) and self.gdop_threshold > 1):
            raise InputError(f"gdop_threshold must be a number above 1 (such as 20), got {self.gdop_threshold}")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsMaps:
    """GPS maps of one epoch. ``A`` altitudes, ``y, x`` cells of the region, row 0 in the south.

    Inside obstacles m and num_visible are 0 and the DOPs inf.

    Attributes:
      m: the metric, 0 to 1.
      gdop, pdop, hdop, vdop, tdop: dilutions of precision; inf with fewer than four satellites or
        where those seen leave the position undetermined.
      num_visible: satellites seen.
    """

    m: Float[Array, "A y x"]
    gdop: Float[Array, "A y x"]
    pdop: Float[Array, "A y x"]
    hdop: Float[Array, "A y x"]
    vdop: Float[Array, "A y x"]
    tdop: Float[Array, "A y x"]
    num_visible: UInt8[Array, "A y x"]


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
    surface: Surface, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, altitudes_m: ArrayLike
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

    Raises:
      InputError: a satellite below the horizon.
    """
    azimuth, elevation = np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float)
    if np.any(elevation < 0):
        raise InputError(
            f"elevation_rad holds a satellite {-math.degrees(elevation.min()):.1f} degrees below the horizon: "
            "give those at or above the elevation mask only"
        )
    grid, region = surface.grid, surface.region
    rows, cols = surface.window
    altitudes = jnp.asarray(altitudes_m, surface.roof_m.dtype)
    top_m = surface.top_m
    ground_m = None if surface.terrain_m is None else surface.crop(surface.terrain_m)
    num_words = max(1, -(-len(azimuth) // WORD_BITS))
    words = jnp.zeros((num_words, *altitudes.shape, *region.shape), jnp.uint32)
    for s in range(len(azimuth)):
        line = digital_line(azimuth[s], elevation[s], grid.resolution_m, grid.first_row, grid.first_col, grid.shape)
        words = mark_visible(words, top_m, ground_m, altitudes, line, s, (rows.start, cols.start))
    return words


@jax.jit
def _maps(
    words: UInt[Array, "W A y x"],
    is_obstacle: Bool[Array, "A y x"],
    satellites: Geometry,
    gdop_threshold: float | Array,
) -> GpsMaps:
    """Return the maps of the satellites seen from free cells, made block by block of cells."""
    shape = is_obstacle.shape
    num = max(is_obstacle.size, BLOCK_CELLS)
    flat = jnp.where(is_obstacle, jnp.uint32(0), words).reshape(len(words), -1)
    flat = jnp.pad(flat, ((0, 0), (0, num - is_obstacle.size)))  # less than a block becomes one

    def fill(block: Array, maps: list[Array]) -> list[Array]:
        start = jnp.minimum(block * BLOCK_CELLS, num - BLOCK_CELLS)  # the last block laps over the one before
        cells = lax.dynamic_slice_in_dim(flat, start, BLOCK_CELLS, axis=1)
        dops = dops_of_words(satellites, cells)
        num_visible = jnp.sum(lax.population_count(cells), axis=0).astype(jnp.uint8)
        found = [gps_metric(dops.gdop, gdop_threshold), *dops, num_visible]
        return [lax.dynamic_update_slice(old, new, (start,)) for old, new in zip(maps, found, strict=True)]

    empty = [*[jnp.zeros(num, satellites.basis.dtype)] * 6, jnp.zeros(num, jnp.uint8)]
    maps = lax.fori_loop(0, -(-num // BLOCK_CELLS), fill, empty)
    m, gdop, pdop, hdop, vdop, tdop, num_visible = (values[: is_obstacle.size].reshape(shape) for values in maps)
    return GpsMaps(m, gdop, pdop, hdop, vdop, tdop, num_visible)


def compute_gps(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike,
    params: GpsParams | None = None,
) -> GpsMaps:
    """Return the GPS maps of the region at every altitude, for one epoch.

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
    altitudes = jnp.asarray(altitudes_m, surface.roof_m.dtype)
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes)
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
    satellites = geometry(unit_vectors(azimuth_rad, elevation_rad), multiple_of=SATELLITES_STEP)
    return _maps(words, is_obstacle, satellites, (params or GpsParams()).gdop_threshold)
