"""How much memory the work on tiles takes, and how many tiles at a time fit under a ceiling."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import psutil

from jaxurban.errors import InputError
from jaxurban.kernels.distance.exact import window_cells
from jaxurban.kernels.lidar import flat_cpu
from jaxurban.kernels.lidar.flat import WORD_BITS, num_steps
from jaxurban.kernels.lidar.supersampled import halo_cells
from jaxurban.kernels.lidar.terrain_cpu import TILE
from jaxurban.maps.dataset import variables
from jaxurban.maps.device import Gpu, gpu_free_bytes
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import Metric
from jaxurban.metrics.registry import METRICS
from jaxurban.world.city import SLABS
from jaxurban.world.grid import Grid
from jaxurban.world.tiling import max_side_for, tile_shape

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
DEFAULT_SHARE = 0.5  # of the memory that is free when a run begins
SERIES_BYTES = 384 * 2**20  # a tile's metric at every time of a long series takes at most this

# Measured (see docs/scale.md) and rounded up.
COMPILING_BYTES = 320 * 2**20  # what compiling takes beside the libraries, which this process holds already
SURFACE_CELL_BYTES = 20  # rasters on the host and for JAX while they are put together, or crops of them for the lidar
TERRAIN_CELL_BYTES = 16  # the same of the terrain
RAISED_CELL_BYTES = 12  # where slabs hang: roofs of what stands, and of what an altitude meets (computed, not measured)
LIDAR_RESULT_BYTES = 24  # of counts and shares of the tile's own cells
TERRAIN_RESULT_BYTES = 12  # the same over terrain
LOOK_BYTES = 64  # a look of a ray, while equal ones are joined (`kernels.lidar.terrain.distinct_looks`) or listed
TERRAIN_BLOCK_BYTES = 9  # over terrain: ground, rise and class of cells around the receivers that are taken together
# What the shapes of kernels for a GPU take beside, as compiled for one (benchmarks/cuda_compile.json).
SHADOW_GPU_BYTES = 64  # of a satellite over a cell of the tile and its halo: shadows are cast by doubling
LIDAR_GPU_WORD_BYTES = 4.4  # over flat ground: 32 results of a step, and a tenth
TERRAIN_GPU_BYTES = 400  # of a tile's own cell: the lidar's rays over terrain
PROTECTION_CELL_BYTES = 40  # the distinct patterns at worst, their number in each cell, and one altitude's maps
SERIES_PROTECTION_BYTES = 5  # of a time: m, and whether both levels are within their limits
RISK_CELL_BYTES = 64  # of cells within the risk's threshold: squared distances and what a pass over them holds
OTHER_CELL_BYTES = 8  # of a metric that is not measured, by variable: what it computes, and its layer
SUBCELL_BYTES = 48  # rasters of the supersampled surface, its tops for both directions, and the lidar's order of them
SPREAD_CELL_BYTES = 4 * 10 * 3  # about ten arrays of each of three metrics
GEOTIFF_CELL_BYTES = 14  # of a row of tiles, all across the region, while a GeoTIFF is made of it
PROGRAM_BYTES = 120 * 2**20  # the programs compiled for the tiles of one resolution
WORKER_BYTES = 700 * 2**20  # a worker process with everything imported, before its first tile
ENDLESS_BYTES = 2**80  # more than any machine has
CGROUP = Path("/sys/fs/cgroup")  # what a container may use, under Linux


MOST_UNITS = 1e12  # of memory, in any unit


def parse_bytes(text: str, name: str = "memory") -> int:
    """Return the bytes in a size such as ``"4GiB"``, ``"512 MB"`` or ``"4g"``; all units are powers of 1,024.

    Raises:
      InputError: no such size.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if match is None or not 0 < float(match[1]) < MOST_UNITS:
        raise InputError(f"{name} must be a size such as 4GiB or 800MiB, got {text!r}")
    return int(float(match[1]) * UNITS[match[2].upper()])


def told_bytes(num_bytes: float) -> str:
    """Return a size as people read it."""
    if num_bytes < 2**30:
        return f"{num_bytes / 2**20:.0f} MiB" if num_bytes >= 2**20 else "less than 1 MiB"
    return f"{num_bytes / 2**30:.1f} GiB" if num_bytes < 10 * 2**30 else f"{num_bytes / 2**30:,.0f} GiB"


def shape_of_tiles(task: MapTask) -> tuple[int, int]:
    """Return rows and columns of the tiles of a region; settings decide it, never the machine."""
    if task.keeps_times:
        return tile_shape(task.region.shape)
    series_bytes = 4 * task.num_times * len(task.params.altitudes_m)
    return tile_shape(task.region.shape, max_side_for(series_bytes, SERIES_BYTES))


def tile_bytes(task: MapTask, tile: Grid, around: Grid | None = None) -> int:
    """Return about how many bytes the work on one tile takes at its highest.

    Args:
      task: what the maps are made of.
      tile: a part of its region, or all of it.
      around: what is rasterised for it; left out, the halo of a tile that its neighbours hand shadows on to.
    """
    around = around or task.with_halo(tile)
    surface = _num_cells(around) * (
        SURFACE_CELL_BYTES + TERRAIN_CELL_BYTES * task.has_terrain + RAISED_CELL_BYTES * (task.city.hanging == SLABS)
    )
    try:
        return int(surface + _metric_bytes(task, tile) + _supersampling_bytes(task, tile))
    except OverflowError:  # of a range or threshold that is a mistyped number
        return ENDLESS_BYTES


def tile_gpu_bytes(task: MapTask, tile: Grid) -> int:
    """Return about how many bytes of a GPU's memory the work on one tile takes at its highest."""
    satellites = max(len(task.satellites_at(number)) for number in range(task.num_times))
    shadows = _num_cells(task.with_halo(tile)) * satellites * SHADOW_GPU_BYTES
    lidar = _num_cells(tile) * TERRAIN_GPU_BYTES if task.has_terrain else _lidar_words_bytes(task, tile)
    return int(tile_bytes(task, tile) + shadows + lidar * ("lidar" in task.metrics))


def whole_bytes(task: MapTask) -> int:
    """Return about how many bytes the maps of a region take at their highest, made at once as `build_maps` does."""
    params, cells = task.params, _num_cells(task.region)
    sizes = {"time": task.num_times, "altitude": len(params.altitudes_m), "time_of_day": len(params.times_of_day)}
    held = sum(
        cells * kind.itemsize * math.prod(sizes.get(dim, 1) for dim in dims) for dims, kind in variables(task).values()
    )
    return tile_bytes(task, task.region, task.with_margin()) + held


def _num_cells(grid: Grid, halo: int = 0) -> int:
    return (grid.num_rows + 2 * halo) * (grid.num_cols + 2 * halo)


def _metric_bytes(task: MapTask, tile: Grid) -> float:
    """Return about how many bytes the metrics of some cells take, beside the rasters that they look at."""
    return sum(MEASURED.get(name, _other_bytes)(task, tile, metric) for name, metric in task.metrics.items())


def _gps_bytes(task: MapTask, tile: Grid, metric: Metric) -> float:
    cells, altitudes = _num_cells(tile), len(task.params.altitudes_m)
    weighted = 24 * (len(metric.also) > len(METRICS["gps"].also))  # DOPs, and m once more
    words = cells * (
        16 * altitudes + 48 + weighted
    )  # of up to 64 satellites, twice if supersampled; maps of one altitude
    return words + (0 if task.keeps_times else cells * 4 * task.num_times * altitudes)


def _lidar_bytes(task: MapTask, tile: Grid, metric: Metric) -> float:
    steps = num_steps(tile.resolution_m, task.params.lidar.range_m)
    halo = steps - 1
    if task.has_terrain:
        return _num_cells(tile) * TERRAIN_RESULT_BYTES + _looks_bytes(task, steps, halo)
    return _num_cells(tile) * LIDAR_RESULT_BYTES + _bitmap_bytes(task, steps, halo)


def _bitmap_bytes(task: MapTask, steps: int, halo: int, num_phases: int = 1) -> float:
    """Return the bytes of the lidar over flat ground whatever the size of the tile: looks, bitmaps, what returned."""
    (rows, cols), azimuths = flat_cpu.TILE, task.params.lidar.azimuths
    band = rows // flat_cpu.WORD_BITS
    bitmaps = max(flat_cpu.BITMAP_BYTES, num_phases * (band + 2 * halo) * (cols + 2 * halo))
    return steps * azimuths * LOOK_BYTES + bitmaps + azimuths * band * cols


def _lidar_words_bytes(task: MapTask, tile: Grid) -> float:
    """Return what the lidar over flat ground takes in JAX: a bit a step for every cell in its range.

    As words are bands of rows, each with a halo of its own, these bits are up to 32 times the cells around.
    """
    steps = num_steps(tile.resolution_m, task.params.lidar.range_m)
    halo, band = steps - 1, -(-tile.num_rows // WORD_BITS)
    return steps * (band + 2 * halo) * (tile.num_cols + 2 * halo) * LIDAR_GPU_WORD_BYTES


def _looks_bytes(task: MapTask, steps: int, halo: int, num_phases: int = 1) -> float:
    """Return the bytes of the lidar over terrain whatever the size of the tile: looks, and a block of receivers."""
    block = num_phases * math.prod(side + 2 * halo for side in TILE)
    return steps * task.params.lidar.azimuths * LOOK_BYTES + block * TERRAIN_BLOCK_BYTES


def _risk_bytes(task: MapTask, tile: Grid, metric: Metric) -> float:
    return _num_cells(tile, window_cells(task.params.risk.threshold_m, tile.resolution_m)) * RISK_CELL_BYTES


def _other_bytes(task: MapTask, tile: Grid, metric: Metric) -> float:
    reach_m = metric.reach_m(task.settings_of(metric))
    around = _num_cells(tile, math.ceil(reach_m / tile.resolution_m)) if reach_m else 0
    return OTHER_CELL_BYTES * (_num_cells(tile) * (1 + len(metric.also)) + around)


def _protection_bytes(task: MapTask, tile: Grid, metric: Metric) -> float:
    cells, altitudes = _num_cells(tile), len(task.params.altitudes_m)
    series = 0 if task.keeps_times else cells * SERIES_PROTECTION_BYTES * task.num_times * altitudes
    return cells * (16 * altitudes + PROTECTION_CELL_BYTES) + series


MEASURED: dict[str, Callable[[MapTask, Grid, Metric], float]] = {
    "gps": _gps_bytes,
    "lidar": _lidar_bytes,
    "protection": _protection_bytes,
    "risk": _risk_bytes,
}


def _supersampling_bytes(task: MapTask, tile: Grid) -> float:
    """Return about how many bytes supersampling and spreads add to a tile and the margin that shadows it."""
    params, cells, needed = task.params, _num_cells(task.with_margin(tile)), 0.0
    if params.oversample > 1 or params.gps_bounds:
        needed += cells * params.oversample**2 * SUBCELL_BYTES
        steps = num_steps(tile.resolution_m / params.oversample, params.lidar.range_m)
        if task.has_terrain:
            needed += _looks_bytes(task, steps, halo_cells(steps, params.oversample), params.oversample**2)
        else:
            needed += _bitmap_bytes(task, steps, halo_cells(steps, params.oversample), params.oversample**2)
    if params.height_samples:
        needed += cells * len(params.altitudes_m) * SPREAD_CELL_BYTES
    return needed


@dataclass(frozen=True)
class MemoryPlan:
    """How a run keeps under its ceiling.

    Attributes:
      ceiling_bytes: memory of all processes together.
      needed_bytes: the estimate for ``num_workers``.
      num_workers: tiles worked on at a time, if there are so many; and GeoTIFFs.
      num_at_once: tiles worked on at a time, which are no more than there are.
    """

    ceiling_bytes: int
    needed_bytes: int
    num_workers: int
    num_at_once: int


def free_bytes() -> int:
    """Return how much memory this process may still take: what the machine has, or its container if that is less."""
    free = psutil.virtual_memory().available
    try:
        limit = int((CGROUP / "memory.max").read_text())
        used = int(dict(line.split() for line in (CGROUP / "memory.stat").read_text().splitlines())["anon"])
    except (OSError, ValueError, KeyError):  # another system, or "max": no limit
        return free
    return min(free, limit - used)


def check_fits(task: MapTask) -> int:
    """Return about how many bytes this process will take while it makes the maps of a region at once.

    Raises:
      InputError: more than there are.
    """
    region, needed, free = task.region, COMPILING_BYTES + PROGRAM_BYTES + whole_bytes(task), free_bytes()
    if needed > free:
        raise InputError(
            f"the maps of {region.num_rows:,} x {region.num_cols:,} cells of {region.resolution_m:g} m need about "
            f"{told_bytes(needed)} of memory at once and {told_bytes(free)} are free: choose a smaller region, a "
            "coarser resolution_m or a shorter lidar range_m, or make them with `jaxurban maps`, which works tile by "
            "tile"
        )
    return psutil.Process().memory_info().rss + needed


def plan_memory(
    ceiling_bytes: int | None,
    per_tile_bytes: int,
    num_workers: int,
    num_processes: int = 0,
    num_resolutions: int = 1,
    num_tiles: int | None = None,
) -> MemoryPlan:
    """Return how many tiles to work on at a time, at most ``num_workers``.

    Args:
      ceiling_bytes: of all processes together; None for `DEFAULT_SHARE` of the free memory.
      per_tile_bytes: from `tile_bytes`.
      num_workers: wanted; each process works on as many tiles.
      num_processes: beside this one, that do the work; 0 where its threads do.
      num_resolutions: whose tiles are made one after the other.
      num_tiles: that have maps; None if there are more than workers.

    Raises:
      InputError: not even one tile fits (or not one in each process).
    """
    own, least = psutil.Process().memory_info().rss, num_processes or 1
    if ceiling_bytes is None:
        ceiling_bytes = int(own + DEFAULT_SHARE * free_bytes())
    base = own + num_resolutions * PROGRAM_BYTES * least + (num_processes * WORKER_BYTES or COMPILING_BYTES)
    fitting = int((ceiling_bytes - base) // per_tile_bytes)
    if fitting < least:
        remedy = "fewer --workers" if num_processes > 1 else "a coarser [region] resolution_m"
        raise InputError(
            f"this job needs about {told_bytes(base + per_tile_bytes * least)} of memory and may take "
            f"{told_bytes(ceiling_bytes)}: raise --memory, or choose {remedy}, a shorter [lidar] range_m or [risk] "
            "threshold_m, or fewer altitudes or times"
        )
    num = min(num_workers, fitting) // least * least
    num_tiles = num if num_tiles is None else num_tiles
    needed_bytes = int(base + min(num, max(num_tiles, least)) * per_tile_bytes)
    return MemoryPlan(ceiling_bytes, needed_bytes, num, min(num, num_tiles))


def plan_run(
    tasks: Sequence[MapTask],
    ceiling_bytes: int | None,
    num_workers: int,
    num_processes: int = 0,
    gpus: Sequence[Gpu] = (),
) -> MemoryPlan:
    """Return how a run of some tasks, one after the other, keeps under its memory ceiling; arguments as `plan_memory`.

    On a GPU as many tiles are worked on as its own memory holds: this process's, or those of the worker processes
    (``gpus``).

    Raises:
      InputError: it cannot.
    """
    most_bytes, most_gpu_bytes, num_tiles = 0, 0, 1
    for task in tasks:
        shape, region = shape_of_tiles(task), task.region
        tile = replace(region, num_rows=shape[0], num_cols=shape[1])
        num_tiles = max(num_tiles, -(-region.num_rows // shape[0]) * -(-region.num_cols // shape[1]))
        most_bytes = max(most_bytes, tile_bytes(task, tile), shape[0] * region.num_cols * GEOTIFF_CELL_BYTES)
        most_gpu_bytes = max(most_gpu_bytes, tile_gpu_bytes(task, tile))
    fitting = _fitting_on_gpus(most_gpu_bytes, num_workers, gpus)
    return plan_memory(ceiling_bytes, most_bytes, fitting, num_processes, len(tasks), num_tiles)


def _fitting_on_gpus(per_tile_bytes: int, num_workers: int, gpus: Sequence[Gpu]) -> int:
    """Return how many tiles GPUs hold at a time, ``num_workers`` at most and where JAX computes on a CPU.

    Args:
      per_tile_bytes: from `tile_gpu_bytes`.
      num_workers: as for `plan_memory`.
      gpus: of worker processes, which share the tiles alike; empty: this process's own.

    Raises:
      InputError: not one tile fits.
    """
    known = [free for free in ([gpu.limit_bytes for gpu in gpus] or [gpu_free_bytes()]) if free is not None]
    if not known:
        return num_workers
    free = min(known)
    if per_tile_bytes > free:
        raise InputError(
            f"a tile needs about {told_bytes(per_tile_bytes)} of the GPU's memory and {told_bytes(free)} are free: end "
            "what else uses it, choose a shorter [lidar] range_m or fewer altitudes or times, or take --device cpu"
        )
    return min(num_workers, int(free // per_tile_bytes) * max(1, len(gpus)))


def plan_sentence(tasks: Sequence[MapTask], plan: MemoryPlan, disk_bytes: int, duration: str) -> str:
    """Return what a run tells of its size, memory, disk and duration before it begins."""
    cells = sum(_num_cells(task.region) for task in tasks)
    disk = f"{'about ' * (disk_bytes >= 2**20)}{told_bytes(disk_bytes)} of disk"
    if not plan.ceiling_bytes:
        return f"{cells:,} cells on a Dask cluster: {disk}"
    return (
        f"{cells:,} cells, {plan.num_at_once} tile{'s' * (plan.num_at_once > 1)} at a time: about "
        f"{told_bytes(plan.needed_bytes)} of memory at most, of {told_bytes(plan.ceiling_bytes)} allowed, "
        f"{disk}, {duration}"
    )
