"""How much memory the work on tiles takes, and how many tiles at a time fit under a ceiling."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import psutil

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.kernels.distance import window_cells
from jaxurban.kernels.lidar import WORD_BITS, num_steps
from jaxurban.layers import MapParams, halo_cells, margin_of, variables
from jaxurban.sky import Sky
from jaxurban.tiles import max_side_for, tile_shape

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
DEFAULT_SHARE = 0.5  # of the memory that is free when a run begins
SERIES_BYTES = 384 * 2**20  # a tile's metric at every epoch of a long series takes at most this

# Measured (see docs/scale.md) and rounded up.
COMPILING_BYTES = 400 * 2**20  # what JAX and the other libraries take once they work
SURFACE_CELL_BYTES = 20  # rasters on the host and for JAX, and what puts them together
TERRAIN_CELL_BYTES = 16  # the same of the terrain, and the sum of both
LIDAR_CELL_BYTES = 16  # of cells within the lidar's range: crops, with their halo, and padded
RISK_CELL_BYTES = 64  # of cells within the risk's threshold: squared distances and what a pass over them holds
LOOK_BYTES = 1024  # over terrain: a look (see `jaxurban.kernels.terrain_lidar`), and what joins them
FINE_CELL_BYTES = 48  # rasters of the finer surface, its tops for both directions, and the lidar's order of them
SPREAD_CELL_BYTES = 4 * 10 * 3  # about ten arrays of each of three metrics
PROGRAM_BYTES = 120 * 2**20  # the programs compiled for the tiles of one resolution
WORKER_BYTES = 700 * 2**20  # a worker process with everything imported, before its first tile
CGROUP = Path("/sys/fs/cgroup")  # what a container may use, under Linux


def parse_bytes(text: str, name: str = "memory") -> int:
    """Return the bytes in a size such as ``"4GiB"``, ``"512 MB"`` or ``"4g"``; all units are powers of 1,024.

    Raises:
      InputError: no such size.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if match is None or float(match[1]) == 0:
        raise InputError(f"{name} must be a size such as 4GiB or 800MiB, got {text!r}")
    return int(float(match[1]) * UNITS[match[2].upper()])


def gib(num_bytes: float) -> str:
    """Return a size as people read it."""
    return f"{num_bytes / 2**30:.1f} GiB" if num_bytes < 10 * 2**30 else f"{num_bytes / 2**30:,.0f} GiB"


def shape_of_tiles(shape: tuple[int, int], params: MapParams, num_epochs: int) -> tuple[int, int]:
    """Return rows and columns of the tiles of a region; settings decide it, never the machine."""
    if params.gps.keeps_epochs(num_epochs):
        return tile_shape(shape)
    return tile_shape(shape, max_side_for(4 * num_epochs * len(params.altitudes_m), SERIES_BYTES))


def tile_bytes(
    shape: tuple[int, int], resolution_m: float, params: MapParams, num_epochs: int, has_terrain: bool
) -> int:
    """Return about how many bytes the work on one tile takes at its highest."""
    around = _around(shape, halo_cells(resolution_m, params)) * (SURFACE_CELL_BYTES + TERRAIN_CELL_BYTES * has_terrain)
    return around + _metric_bytes(shape, resolution_m, params, num_epochs, has_terrain)


def whole_bytes(city: City, region: Grid, sky: Sky, params: MapParams) -> int:
    """Return about how many bytes the maps of a region take at their highest, made at once as `build_maps` does."""
    surface, num_epochs, has_terrain = margin_of(city, region, sky, params), len(sky.times), city.terrain is not None
    cells = region.num_rows * region.num_cols
    needed = surface.num_rows * surface.num_cols * (SURFACE_CELL_BYTES + TERRAIN_CELL_BYTES * has_terrain)
    needed += _metric_bytes(region.shape, region.resolution_m, params, num_epochs, has_terrain)
    sizes = {"time": num_epochs, "altitude": len(params.altitudes_m), "time_of_day": len(params.times_of_day)}
    held = variables(params, num_epochs, city.blocks is not None, has_terrain).values()
    needed += sum(cells * kind.itemsize * math.prod(sizes.get(dim, 1) for dim in dims) for dims, kind in held)
    return needed + detail_bytes(surface, params)


def _around(shape: tuple[int, int], halo: int) -> int:
    return (shape[0] + 2 * halo) * (shape[1] + 2 * halo)


def _metric_bytes(
    shape: tuple[int, int], resolution_m: float, params: MapParams, num_epochs: int, has_terrain: bool
) -> int:
    """Return about how many bytes the metrics of some cells take, beside the rasters that they look at.

    On fine cells the lidar decides: it keeps a bit a step for every cell within its range, and as words are bands of
    rows, each with a halo of its own, these bits are up to 32 times the cells around.
    """
    cells, altitudes = shape[0] * shape[1], len(params.altitudes_m)
    steps = num_steps(resolution_m, params.lidar.range_m)
    halo, band = steps - 1, -(-shape[0] // WORD_BITS)
    lidar = _around(shape, halo) * LIDAR_CELL_BYTES * (1 + has_terrain) + 24 * cells
    if has_terrain:
        lidar += steps * params.lidar.num_azimuths * LOOK_BYTES
    else:
        lidar += steps * (band + 2 * halo) * (shape[1] + 2 * halo) * 4
    risk = _around(shape, window_cells(params.risk.threshold_m, resolution_m)) * RISK_CELL_BYTES
    gps = cells * (16 * altitudes + 48)  # words, before and after a satellite; one altitude's maps
    if not params.gps.keeps_epochs(num_epochs):
        gps += cells * 4 * num_epochs * altitudes
    return int(lidar + risk + gps)


def detail_bytes(surface: Grid, params: MapParams) -> int:
    """Return about how many bytes finer answers and spreads add to a tile.

    Args:
      surface: the tile and the margin that shadows it.
      params: settings.
    """
    cells, needed = surface.num_rows * surface.num_cols, 0
    if params.oversample > 1 or params.gps_bounds:
        needed += cells * params.oversample**2 * FINE_CELL_BYTES
        steps = num_steps(surface.resolution_m / params.oversample, params.lidar.range_m)
        needed += steps * params.lidar.num_azimuths * LOOK_BYTES
    if params.height_samples:
        needed += cells * len(params.altitudes_m) * SPREAD_CELL_BYTES
    return needed


@dataclass(frozen=True)
class MemoryPlan:
    """How a run keeps under its ceiling.

    Attributes:
      ceiling_bytes: memory of all processes together.
      needed_bytes: the estimate for ``num_workers``.
      num_workers: tiles worked on at a time.
    """

    ceiling_bytes: int
    needed_bytes: int
    num_workers: int


def free_bytes() -> int:
    """Return how much memory this process may still take: what the machine has, or its container if that is less."""
    free = psutil.virtual_memory().available
    try:
        limit = int((CGROUP / "memory.max").read_text())
        used = int(dict(line.split() for line in (CGROUP / "memory.stat").read_text().splitlines())["anon"])
    except (OSError, ValueError, KeyError):  # another system, or "max": no limit
        return free
    return min(free, limit - used)


def check_fits(city: City, region: Grid, sky: Sky, params: MapParams) -> int:
    """Return about how many bytes this process will take while it makes the maps of a region at once.

    Raises:
      InputError: more than there are.
    """
    needed, free = COMPILING_BYTES + PROGRAM_BYTES + whole_bytes(city, region, sky, params), free_bytes()
    if needed > free:
        raise InputError(
            f"the maps of {region.num_rows:,} x {region.num_cols:,} cells of {region.resolution_m:g} m need about "
            f"{gib(needed)} of memory at once and {gib(free)} are free: choose a smaller region, a coarser "
            "resolution_m or a shorter lidar range_m, or make them with `jaxurban maps`, which works tile by tile"
        )
    return psutil.Process().memory_info().rss + needed


def plan_memory(
    ceiling_bytes: int | None,
    per_tile_bytes: int,
    num_workers: int,
    has_processes: bool,
    num_resolutions: int = 1,
    num_tiles: int | None = None,
) -> MemoryPlan:
    """Return how many tiles to work on at a time, at most ``num_workers``.

    Args:
      ceiling_bytes: of all processes together; None for `DEFAULT_SHARE` of the free memory.
      per_tile_bytes: from `tile_bytes`.
      num_workers: wanted.
      has_processes: whether every worker is a process of its own, not a thread.
      num_resolutions: whose tiles are made one after the other.
      num_tiles: that have maps; None if there are more than workers.

    Raises:
      InputError: not even one tile fits (or not all processes asked for do).
    """
    own = psutil.Process().memory_info().rss
    if ceiling_bytes is None:
        ceiling_bytes = int(own + DEFAULT_SHARE * free_bytes())
    programs = num_resolutions * PROGRAM_BYTES
    base = own if has_processes else own + COMPILING_BYTES + programs
    each = per_tile_bytes + (WORKER_BYTES + programs if has_processes else 0)
    fitting = int((ceiling_bytes - base) // each)
    if fitting < (num_workers if has_processes else 1):
        least = base + each * (num_workers if has_processes else 1)
        remedy = "fewer --workers" if has_processes and num_workers > 1 else "a coarser [region] resolution_m"
        raise InputError(
            f"this job needs about {gib(least)} of memory and may take {gib(ceiling_bytes)}: raise --memory, or choose "
            f"{remedy}, a shorter [lidar] range_m, or fewer altitudes or epochs"
        )
    num = min(num_workers, fitting)
    at_once = num if has_processes or num_tiles is None else min(num, num_tiles)
    return MemoryPlan(ceiling_bytes, int(base + at_once * each), num)
