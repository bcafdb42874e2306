"""How much memory the work on tiles takes, and how many tiles at a time fit under a ceiling."""

import re
from dataclasses import dataclass

import psutil

from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.kernels.lidar import num_steps
from jaxurban.layers import MapParams
from jaxurban.tiled import halo_cells
from jaxurban.tiles import max_side_for, tile_shape

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
DEFAULT_SHARE = 0.5  # of the memory that is free when a run begins
SERIES_BYTES = 384 * 2**20  # a tile's metric at every epoch of a long series takes at most this

# Measured on the paper's set (see docs/scale.md) and rounded up.
COMPILING_BYTES = 400 * 2**20  # what JAX and the other libraries take once they work
FINE_CELL_BYTES = 24  # rasters of the finer surface, and its tops for both directions
SPREAD_CELL_BYTES = 4 * 10 * 3  # about ten arrays of each of three metrics
PROGRAM_BYTES = 120 * 2**20  # the programs compiled for the tiles of one resolution
WORKER_BYTES = 700 * 2**20  # a worker process with everything imported, before its first tile


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
    halo = halo_cells(resolution_m, params)
    cells, haloed = shape[0] * shape[1], (shape[0] + 2 * halo) * (shape[1] + 2 * halo)
    altitudes = len(params.altitudes_m)
    around = haloed * (24 + 24 * has_terrain)  # rasters, on the host and for JAX, and what pads them
    lidar = cells * (num_steps(resolution_m, params.lidar.range_m) / 8 + 24)  # a bitmap a step, counts
    gps = cells * (10 * altitudes + 48)  # words, before and after a satellite; one altitude's maps
    if not params.gps.keeps_epochs(num_epochs):
        gps += cells * 4 * num_epochs * altitudes
    return int(around + lidar + gps)


def detail_bytes(surface: Grid, params: MapParams) -> int:
    """Return about how many bytes finer answers and spreads add to a tile.

    Args:
      surface: the tile and the margin that shadows it.
      params: settings.
    """
    cells, needed = surface.num_rows * surface.num_cols, 0
    if params.oversample > 1 or params.gps_bounds:
        needed += cells * params.oversample**2 * FINE_CELL_BYTES
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


def plan_memory(
    ceiling_bytes: int | None, per_tile_bytes: int, num_workers: int, has_processes: bool, num_resolutions: int = 1
) -> MemoryPlan:
    """Return how many tiles to work on at a time, at most ``num_workers``.

    Args:
      ceiling_bytes: of all processes together; None for `DEFAULT_SHARE` of the free memory.
      per_tile_bytes: from `tile_bytes`.
      num_workers: wanted.
      has_processes: whether every worker is a process of its own, not a thread.
      num_resolutions: whose tiles are made one after the other.

    Raises:
      InputError: not even one tile fits (or not all processes asked for do).
    """
    own = psutil.Process().memory_info().rss
    if ceiling_bytes is None:
        ceiling_bytes = int(own + DEFAULT_SHARE * psutil.virtual_memory().available)
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
    return MemoryPlan(ceiling_bytes, int(base + num * each), num)
