"""GPS quality: how well the satellites seen from each cell fix a position."""

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, UInt, UInt8

from jaxurban.kernels.dop import AnyGeometry, Clocks, dops_of_words, geometry, unit_vectors
from jaxurban.kernels.patterns import distinct_patterns, look_up
from jaxurban.metrics.base import JAX_ALIGNMENT, AnyArray, zeros_for_jax
from jaxurban.metrics.gps.params import GpsParams

SATELLITES_STEP = 8  # the DOP program is compiled for 8, 16, 24 ... satellites
BLOCK_CELLS = 2**14  # cells whose DOPs are made at once: what they need in between fits a core's cache
WIDE_BLOCK_CELLS = 2**22  # the same on a GPU, which has a launch for every block
TABLE_SATELLITES = 16  # up to here the maps of all subsets are made once and looked up
LEAST_CELLS_A_PATTERN = 4  # above, on a CPU, those of the subsets that are seen, where so many cells share one


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GpsMaps:
    """GPS maps of one time. ``C`` stands for any axes of cells.

    Inside obstacles m and num_visible are 0 and the DOPs inf.

    Attributes:
      m: the metric, 0 to 1.
      gdop, pdop, hdop, vdop, tdop: dilutions of precision; inf with fewer satellites than three and one
        for each clock or where those seen leave the position undetermined.
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


def elevation_weights(elevation_rad: ArrayLike) -> np.ndarray:
    """Return ``[S]`` weights of satellites, sin^2 of the elevation: one over the variance of a range, 1 at the zenith.

    Source: Dach, Lutz, Walser and Fridez 2015, Bernese GNSS Software 5.2, elevation-dependent weighting w = cos^2 z;
    the term of RTKLIB's variance of relative positioning that grows as 1 / sin^2 (Takasu, RTKLIB 2.4, rtkpos.c).
    """
    return np.sin(np.asarray(elevation_rad, float)) ** 2


@jax.jit
def maps_of_words(
    words: UInt[AnyArray, "W ..."],
    satellites: AnyGeometry,
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
    words: UInt[Array, "W ..."], satellites: AnyGeometry, gdop_threshold: float | Array, block_cells: int
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
      weighted: the same satellites, each with the weight of its elevation; None where no weighted DOPs are wanted.
    """

    satellites: AnyGeometry
    table: GpsMaps | None
    gdop_threshold: float
    weighted: "SatelliteSet | None" = None

    @classmethod
    def of(
        cls, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, params: GpsParams, clocks: Clocks | None = None
    ) -> "SatelliteSet":
        """Return the set of the satellites at ``[S]`` azimuths and elevations; without clocks all share one."""
        directions = unit_vectors(azimuth_rad, elevation_rad)
        made = cls._of_geometry(directions, params, clocks)
        if params.weighting == "none":
            return made
        weights = elevation_weights(elevation_rad)
        return replace(made, weighted=cls._of_geometry(directions, params, clocks, weights))

    @classmethod
    def _of_geometry(
        cls, directions: np.ndarray, params: GpsParams, clocks: Clocks | None, weights: np.ndarray | None = None
    ) -> "SatelliteSet":
        satellites = geometry(directions, multiple_of=SATELLITES_STEP, clocks=clocks, weights=weights)
        table = None
        if len(directions) <= TABLE_SATELLITES:
            num = max(BLOCK_CELLS, 2 ** len(directions))
            subsets = np.arange(num, dtype=np.uint32)[None]
            table = maps_of_words(subsets, satellites, params.gdop_threshold)
        return cls(satellites, table, params.gdop_threshold)

    def maps(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> GpsMaps:
        """Return the maps of the satellites seen; inside obstacles no satellite is."""
        if self.table is not None:
            return _looked_up(self.table, words, is_obstacle)
        if jax.default_backend() == "cpu" and (found := self._maps_of_patterns(words, is_obstacle)) is not None:
            return found
        return maps_of_words(words, self.satellites, self.gdop_threshold, is_obstacle)

    def m(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> Float[Array, "*C"]:
        """Return the metric alone."""
        if self.table is None:
            return self.maps(words, is_obstacle).m
        return _looked_up(self.table.m, words, is_obstacle)

    def _maps_of_patterns(self, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]) -> GpsMaps | None:
        """Return the maps by way of every subset that is seen, once; None where too few cells share one.

        They are those of `maps_of_words` to the bit, which takes the subsets a block at a time: one program.
        """
        shape, num_cells = words.shape[1:], math.prod(words.shape[1:])
        flat, is_nothing = np.asarray(words).reshape(len(words), -1), np.asarray(is_obstacle).ravel()
        distinct = distinct_patterns(flat, is_nothing, num_cells // LEAST_CELLS_A_PATTERN)
        if distinct is None:
            return None
        patterns, number = distinct
        num_patterns = patterns.shape[1]
        values, num_visible = np.empty((num_patterns, 6), np.float32), np.empty((num_patterns, 1), np.uint8)
        for first in range(0, num_patterns, BLOCK_CELLS):
            block = np.zeros((len(patterns), BLOCK_CELLS), np.uint32)
            part = patterns[:, first : first + BLOCK_CELLS]
            block[:, : part.shape[1]] = part
            made = maps_of_words(block, self.satellites, self.gdop_threshold)
            rows = slice(first, first + part.shape[1])
            of_all = (made.m, made.gdop, made.pdop, made.hdop, made.vdop, made.tdop)
            values[rows] = np.stack(of_all, axis=1)[: part.shape[1]]
            num_visible[rows, 0] = np.asarray(made.num_visible)[: part.shape[1]]
        return GpsMaps(*_spread(values, number, shape), *_spread(num_visible, number, shape))


def _spread(table: np.ndarray, number: np.ndarray, shape: tuple[int, ...]) -> list[Array]:
    """Return each column of a table ``[P, V]`` at the cells, whose rows are numbered."""
    width = -(-len(number) // JAX_ALIGNMENT) * JAX_ALIGNMENT  # every column begins where JAX takes it as it is
    found = zeros_for_jax((table.shape[1], width), table.dtype)[:, : len(number)]
    look_up(table, number, found)
    return [jax.device_put(column.reshape(shape)) for column in found]


@jax.jit
def _looked_up(table, words: UInt[Array, "W ..."], is_obstacle: Bool[Array, "..."]):
    """Return the entries of a table (or of each of a tree of tables) at the first word; at 0 inside obstacles."""
    index = jnp.where(is_obstacle, jnp.uint32(0), words[0])
    return jax.tree.map(lambda values: values[index], table)
