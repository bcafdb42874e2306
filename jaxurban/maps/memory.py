"""How much memory the work on tiles takes, and how many tiles at a time fit under a ceiling."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import psutil

from jaxurban.errors import InputError
from jaxurban.io.rasterise import PEOPLE_SAMPLES
from jaxurban.maps.free_memory import free_bytes
from jaxurban.maps.task import MapTask, variables
from jaxurban.metrics.base import TIME
from jaxurban.progress import LOG
from jaxurban.world.grid import MAX_SIDE, Grid, tile_shape

DEFAULT_SHARE = 0.5  # of the memory that is free when a run begins
LEAST_SIDE = 64  # of a tile, in cells
SERIES_BYTES = 384 * 2**20  # a tile's metric at every time of a long series takes at most this

# Measured (docs/guides/large.md) and rounded up; what each metric takes of a cell is in its `Metric`.
# Of a process: what compiling takes beside the libraries, the programs of one resolution, and a worker process with
# everything imported, before its first tile.
COMPILING_BYTES = 320 * 2**20
PROGRAM_BYTES = 80 * 2**20
WORKER_BYTES = 700 * 2**20
# Of a cell: rasters of roofs, of the terrain and of roofs at an altitude, on the host and for JAX while they are put
# together, or crops of them for the lidar.
SURFACE_CELL_BYTES = 52
# Of a sample of a cell: the pixel of people under it, of rasters by day and by night.
PEOPLE_SAMPLE_BYTES = 12
# Of a cell at an altitude: which of up to 64 satellites it sees, twice if supersampled; at each time of a series its m
# and whether that is within its limits; and about ten arrays of each of three metrics for a spread.
WORD_BYTES = 16
SERIES_VALUE_BYTES = 5
SPREAD_CELL_BYTES = 4 * 10 * 3
# Of a supersampled cell: the rasters, their tops for both directions, and the lidar's order of them.
SUBCELL_BYTES = 60
# Of a cell in a row of tiles, all across the region, while a GeoTIFF is made of it.
GEOTIFF_CELL_BYTES = 14


def format_bytes(num_bytes: float) -> str:
    """Return a size in words for people, such as ``"4.00 GiB"``."""
    from dask.utils import format_bytes as text_of  # imported here: it takes 0.1 s

    return text_of(int(num_bytes))


def shape_of_tiles(task: MapTask) -> tuple[int, int]:
    """Return the rows and columns of cells of a region's tiles; settings decide them, never the machine.

    The tiles of a long series are smaller, so that a metric at all of its times takes at most `SERIES_BYTES`.
    """
    if task.keeps_times:
        return tile_shape(task.region.shape)
    cell_bytes = 4 * task.num_times * len(task.params.altitudes_m)
    side = max(LEAST_SIDE, math.sqrt(SERIES_BYTES / cell_bytes))
    return tile_shape(task.region.shape, int(min(MAX_SIDE, side)))


def tile_bytes(task: MapTask, tile: Grid, around: Grid | None = None) -> int:
    """Return about how many bytes of memory the work on one tile takes when it takes the most.

    It is the sum of what each stage of the work holds, as if all stages held their arrays at once.

    Args:
      task: what the maps are made of.
      tile: a part of its region, or all of it.
      around: the grid that is rasterised for it; left out, the tile with its halo, which suffices where its neighbours
        hand shadows on.
    """
    params = task.params
    num_cells = _num_cells(tile)
    num_altitudes = len(params.altitudes_m)

    needed = SURFACE_CELL_BYTES * _num_cells(around or task.with_halo(tile))

    # The metrics, each on the tile and on the cells around it that lie within the metric's reach.
    series_bytes = 0 if task.keeps_times else SERIES_VALUE_BYTES * task.num_times
    for metric in task.metrics.values():
        settings = task.settings_of(metric)
        reach = math.ceil(metric.reach_m(settings) / tile.resolution_m)
        needed += _num_cells(tile, reach) * metric.cell_bytes
        is_by_jax = params.engine == "jax" or not metric.is_numba_over_terrain(settings)
        if task.has_terrain and is_by_jax:
            needed += int(metric.terrain_bytes(settings, tile))
        if TIME in metric.dims:
            needed += num_cells * num_altitudes * (WORD_BYTES + series_bytes)

    # Samples of people, where blocks have counts of their own by day.
    if task.city.blocks is not None and task.city.blocks.day_count is not None:
        needed += num_cells * PEOPLE_SAMPLES**2 * PEOPLE_SAMPLE_BYTES

    # Spreads by uncertain heights and supersampled surfaces, on all cells that can shadow the tile.
    margin_bytes = 0
    if params.heights.height_samples:
        margin_bytes += SPREAD_CELL_BYTES * num_altitudes
    if params.oversample > 1 or params.gps.bounds:
        margin_bytes += SUBCELL_BYTES * params.oversample**2
    if margin_bytes:
        needed += margin_bytes * _num_cells(task.with_margin(tile))
    return needed


def maps_bytes(task: MapTask) -> int:
    """Return how many bytes the values of a region's maps are."""
    cell_bytes = 0
    for variable in variables(task).values():
        num_maps = math.prod(task.sizes[dim] for dim in variable.dims)
        cell_bytes += num_maps * np.dtype(variable.dtype).itemsize
    return cell_bytes * _num_cells(task.region)


def _num_cells(grid: Grid, halo: int = 0) -> int:
    """Return the number of cells of a grid with ``halo`` more on each side."""
    return (grid.num_rows + 2 * halo) * (grid.num_cols + 2 * halo)


def check_fits(task: MapTask) -> None:
    """Raise InputError where the maps of a region take more memory than is free, if made as one tile in memory."""
    region = task.region
    free = free_bytes()
    work = tile_bytes(task, region, task.with_margin())
    needed = COMPILING_BYTES + PROGRAM_BYTES + work + maps_bytes(task)
    if needed > free:
        raise InputError(
            f"the maps of {region.num_rows:,} x {region.num_cols:,} cells of {region.resolution_m:g} m need about "
            f"{format_bytes(needed)} of memory at once and {format_bytes(free)} are free: choose a smaller region, a "
            "coarser resolution_m or a shorter lidar range_m, or make them with `jaxurban maps`, which works tile by "
            "tile"
        )


def plan_run(
    tasks: Sequence[MapTask],
    ceiling_bytes: int | None = None,
    num_workers: int = 1,
    num_processes: int = 0,
) -> int:
    """Return how many tiles (and GeoTIFFs) to work on at a time, and write to the log what memory that takes.

    Args:
      tasks: of the resolutions, which are made one after the other.
      ceiling_bytes: on the memory of all processes together; None for that of this one and `DEFAULT_SHARE` of what is
        free.
      num_workers: the most tiles to work on at a time; each process works on an equal number of them.
      num_processes: how many processes beside this one do the work; 0 where the threads of this one do.

    Returns:
      The number, a multiple of the number of processes.

    Raises:
      InputError: not even one tile fits into the memory (or not one for each process).
    """
    # The largest tile of all resolutions, and the most tiles.
    largest_bytes = 0
    num_tiles = 1
    for task in tasks:
        region = task.region
        num_rows, num_cols = shape_of_tiles(task)
        tile = replace(region, num_rows=num_rows, num_cols=num_cols)
        num_in_region = -(-region.num_rows // num_rows) * -(-region.num_cols // num_cols)
        geotiff_bytes = num_rows * region.num_cols * GEOTIFF_CELL_BYTES
        num_tiles = max(num_tiles, num_in_region)
        largest_bytes = max(largest_bytes, tile_bytes(task, tile), geotiff_bytes)

    # What fits into the machine's memory beside the processes themselves and their programs.
    own_bytes = psutil.Process().memory_info().rss
    least_tiles = num_processes or 1
    ceiling = ceiling_bytes or int(own_bytes + DEFAULT_SHARE * free_bytes())
    base_bytes = own_bytes + len(tasks) * PROGRAM_BYTES * least_tiles
    # Without further processes (0) this one compiles the programs.
    base_bytes += num_processes * WORKER_BYTES or COMPILING_BYTES
    fitting = (ceiling - base_bytes) // largest_bytes
    if fitting < least_tiles:
        needed = format_bytes(base_bytes + largest_bytes * least_tiles)
        raise InputError(
            f"this job needs about {needed} of memory and may take {format_bytes(ceiling)}: raise --memory, or choose "
            "fewer --workers, a coarser [region] resolution_m, a shorter [lidar] range_m or [risk] threshold_m, or "
            "fewer altitudes or times"
        )

    # An equal number for each process.
    num_workers = min(num_workers, fitting) // least_tiles * least_tiles
    at_once = min(num_workers, max(num_tiles, least_tiles))
    num_cells = sum(_num_cells(task.region) for task in tasks)
    LOG.info(
        f"{num_cells:,} cells, tiles at a time: {at_once}; about "
        f"{format_bytes(base_bytes + at_once * largest_bytes)} of memory at most, of {format_bytes(ceiling)} allowed"
    )
    return num_workers
