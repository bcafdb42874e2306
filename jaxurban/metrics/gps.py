"""GPS: how well the satellites seen from each cell fix a position."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, UInt, UInt8

from jaxurban.errors import InputError, one_of
from jaxurban.kernels.dop import Geometry, dops, dops_of_words, geometry, unit_vectors
from jaxurban.kernels.shadows.soft import Window, satellite_weights, shadow_heights
from jaxurban.kernels.shadows.sweep import Line, digital_lines, stacked
from jaxurban.metrics.base import ALTITUDE, TIME, AnyArray, Metric, Scene, SoftScene, low_is_bad
from jaxurban.metrics.obstacle import obstacle_mask, soft_obstacle
from jaxurban.metrics.settings import check_softness, check_value, differentiable
from jaxurban.metrics.visibility import visibility
from jaxurban.world.surface import Surface

SATELLITES_STEP = 8  # the DOP program is compiled for 8, 16, 24 ... satellites
BLOCK_CELLS = 2**14  # cells whose DOPs are made at once: what they need in between fits a core's cache
WIDE_BLOCK_CELLS = 2**22  # the same on a GPU, which has a launch for every block
TABLE_SATELLITES = 16  # up to here the maps of all subsets are made once and looked up
MAX_STORED_TIMES = 24  # a longer series keeps statistics over time instead of every time's maps
SERIES = ("auto", "epochs", "statistics")


@differentiable("gdop_threshold")
@dataclass(frozen=True)
class GpsParams:
    """Settings of the GPS metric. A pytree whose leaf is the threshold.

    Attributes:
      gdop_threshold: GDOP at and above which m is 0, > 1.
      series: what is kept of several times: every one of them (``"epochs"``), statistics over time
        (``"statistics"``, see `jaxurban.metrics.availability`), or statistics above `MAX_STORED_TIMES`
        (``"auto"``).
      availability_threshold: m above which a position counts as available, in [0, 1).

    Raises:
      InputError: a value that is none of these.
    """

    gdop_threshold: float = 20.0
    series: Literal["auto", "epochs", "statistics"] = "auto"
    availability_threshold: float = 0.5

    def __post_init__(self) -> None:
        what = "a number above 1 (such as 20)"
        check_value("gdop_threshold", self.gdop_threshold, what, lambda threshold: threshold > 1)
        one_of("series", self.series, SERIES)
        if not 0 <= self.availability_threshold < 1:
            raise InputError(
                f"availability_threshold must be a value of m from 0 to below 1, got {self.availability_threshold}"
            )

    def keeps_times(self, num_times: int) -> bool:
        """Return whether the maps of every time are kept, not statistics over them."""
        return self.series == "epochs" or (self.series == "auto" and num_times <= MAX_STORED_TIMES)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsMaps:
    """GPS maps of one time. ``C`` stands for any axes of cells.

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


@jax.jit
def maps_of_words(
    words: UInt[AnyArray, "W ..."],
    satellites: Geometry,
    gdop_threshold: float | Array,
    is_obstacle: Bool[Array, "..."] | None = None,
) -> GpsMaps:
    """Return the maps of the satellites whose bits are set, made block by block of cells.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
      satellites: their geometry.
      gdop_threshold: see `gps_metric`.
      is_obstacle: where no satellite is seen, whatever the words say; left out, nowhere.
    """
    if is_obstacle is not None:
        words = jnp.where(is_obstacle, jnp.uint32(0), words)
    small, wide = (partial(_in_equal_blocks, block_cells=cells) for cells in (BLOCK_CELLS, WIDE_BLOCK_CELLS))
    return lax.platform_dependent(words, satellites, gdop_threshold, cpu=small, default=wide)


def _in_equal_blocks(
    words: UInt[Array, "W ..."], satellites: Geometry, gdop_threshold: float | Array, block_cells: int
) -> GpsMaps:
    """Return `maps_of_words`, so many cells at once; a block of `BLOCK_CELLS` at least is made."""
    shape = words.shape[1:]
    size = math.prod(shape)
    num = max(size, BLOCK_CELLS)
    block_cells = min(block_cells, num)
    flat = jnp.pad(words.reshape(len(words), -1), ((0, 0), (0, num - size)))  # less than a block becomes one

    def fill(block: Array, maps: list[Array]) -> list[Array]:
        start = jnp.minimum(block * block_cells, num - block_cells)  # the last block laps over the one before
        cells = lax.dynamic_slice_in_dim(flat, start, block_cells, axis=1)
        dops = dops_of_words(satellites, cells)
        num_visible = jnp.sum(lax.population_count(cells), axis=0).astype(jnp.uint8)
        found = [gps_metric(dops.gdop, gdop_threshold), *dops, num_visible]
        return [lax.dynamic_update_slice(old, new, (start,)) for old, new in zip(maps, found, strict=True)]

    empty = [*[jnp.zeros(num, satellites.basis.dtype)] * 6, jnp.zeros(num, jnp.uint8)]
    maps = lax.fori_loop(0, -(-num // block_cells), fill, empty)
    return GpsMaps(*(values[:size].reshape(shape) for values in maps))


@dataclass(frozen=True)
class SatelliteSet:
    """The satellites of one time, made ready to turn visibility words into maps.

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
    def of(cls, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, params: GpsParams) -> "SatelliteSet":
        """Return the set of the satellites at ``[S]`` azimuths and elevations."""
        directions = unit_vectors(azimuth_rad, elevation_rad)
        satellites = geometry(directions, multiple_of=SATELLITES_STEP)
        table = None
        if len(directions) <= TABLE_SATELLITES:
            num = max(BLOCK_CELLS, 2 ** len(directions))
            subsets = np.arange(num, dtype=np.uint32)[None]
            table = maps_of_words(subsets, satellites, params.gdop_threshold)
        return cls(satellites, table, params.gdop_threshold)

    def maps(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> GpsMaps:
        """Return the maps of the satellites seen; inside obstacles no satellite is."""
        if self.table is None:
            return maps_of_words(words, self.satellites, self.gdop_threshold, is_obstacle)
        return _looked_up(self.table, words, is_obstacle)

    def m(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> Float[Array, "*C"]:
        """Return the metric alone."""
        if self.table is None:
            return self.maps(words, is_obstacle).m
        return _looked_up(self.table.m, words, is_obstacle)


@jax.jit
def _looked_up(table, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]):
    """Return the entries of a table (or of each of a tree of tables) at the first word; at 0 inside obstacles."""
    index = jnp.where(is_obstacle, jnp.uint32(0), words[0])
    return jax.tree.map(lambda values: values[index], table)


def compute_gps(
    surface: Surface,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    altitudes_m: ArrayLike,
    params: GpsParams | None = None,
) -> GpsMaps:
    """Return the GPS maps of the region at every altitude, for one time, ``[A, y, x]``.

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
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes_m)
    return gps_of_words(words, is_obstacle, azimuth_rad, elevation_rad, params)


def gps_of_words(
    words: UInt[Array, "W A y x"],
    is_obstacle: Bool[Array, "A y x"],
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    params: GpsParams | None = None,
) -> GpsMaps:
    """Return the GPS maps of satellites seen as `visibility` says, from the cells that are not obstacles.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
      is_obstacle: where nobody flies.
      azimuth_rad, elevation_rad: ``[S]`` as for `compute_gps`.
      params: settings; left out, the paper's.
    """
    return SatelliteSet.of(azimuth_rad, elevation_rad, params or GpsParams()).maps(words, is_obstacle)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsView:
    """The satellites of one time over one surface, made ready on the host; a pytree for `soft_gps`.

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
          oversample: n, for a surface n times finer than the map (`jaxurban.maps.supersampling`): receivers stand in
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
        lines = digital_lines(azimuth, elevation, grid.resolution_m, grid.first_row, grid.first_col, grid.shape)
        rows, cols = surface.window
        return cls(
            stacked(lines),
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
    `jaxurban.kernels.shadows.soft.satellite_weights`. As softness goes to 0 it tends to `compute_gps` wherever no
    shadow ends at the altitude itself; at softness 0 it is that but for rounding (`soft_gps_maps` turns to the exact
    program, bit for bit). Fewer than four satellites need no rule of their own: as the fourth weight goes to 0, GDOP
    passes T and m comes to 0. Computed in the type of the roofs.

    Differentiable in ``surface.roof_m`` (and terrain), ``altitude_m``, ``params.gdop_threshold`` and ``softness_m``,
    all of which may be traced; batch by `jax.vmap`. The gradient by roofs and altitude is exact for the soft map while
    the same tops throw the shadows; undefined where two of them tie and where GDOP is just T; 0 in obstacles, where
    GDOP is above T, and in roofs that throw no shadow. By T it is exact, 0 above. Docs: gradients/gps.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground: a number, or one for each cell of the result.
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
    """Return the soft m_gps at every altitude, for one time; with softness 0 that of `compute_gps`, bit for bit.

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


DOPS = ("gdop", "pdop", "hdop", "vdop", "tdop")


def _maps(scene: Scene, params: GpsParams) -> dict[str, Array]:
    """Return m, the DOPs and the satellites seen; they were made ready under the same settings."""
    assert scene.satellites is not None
    assert scene.words is not None
    assert scene.is_obstacle is not None
    if scene.only_m:
        return {"gps": scene.satellites.m(scene.words, scene.is_obstacle)}
    maps = scene.satellites.maps(scene.words, scene.is_obstacle)
    return {"gps": maps.m, **{name: getattr(maps, name) for name in (*DOPS, "num_visible")}}


def _soft(scene: SoftScene, params: GpsParams) -> Array:
    return soft_gps(scene.surface, scene.altitude_m, params, scene.softness_m, scene.view, cells=scene.cells)


METRIC = Metric(
    name="gps",
    params=GpsParams,
    dims=(TIME, ALTITUDE),
    compute=_maps,
    soft=_soft,
    cost=low_is_bad,
    label="GPS quality",
    one_means="GDOP of 1, the best possible",
    colour="#0072b2",
    colour_map="viridis",
    also={**dict.fromkeys(DOPS, np.float32), "num_visible": np.uint8},
)
