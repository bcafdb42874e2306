"""How much memory and disk the work on tiles takes, and how many tiles at a time fit under a ceiling."""

import math
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath

import jax
import numpy as np
import psutil

from jaxurban.errors import InputError
from jaxurban.io.read.rasterise import PEOPLE_SAMPLES
from jaxurban.kernels.lidar.hard import WORD_BITS, num_steps
from jaxurban.maps.task import MapTask, variables
from jaxurban.metrics.base import TIME
from jaxurban.progress import LOG
from jaxurban.settings import SLABS
from jaxurban.world.grid import MAX_SIDE, Grid, tile_shape

UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
DEFAULT_SHARE = 0.5  # of the memory that is free when a run begins
LEAST_SIDE = 64  # of a tile, in cells
SERIES_BYTES = 384 * 2**20  # a tile's metric at every time of a long series takes at most this

# Measured (docs/guides/large.md) and rounded up; what each metric takes of a cell is in its `Metric`.
COMPILING_BYTES = (
    320 * 2**20
)  # what compiling takes beside the libraries, which this process holds already
SURFACE_CELL_BYTES = 20  # rasters on the host and for JAX while they are put together, or crops of them for the lidar
TERRAIN_CELL_BYTES = (
    16  # the same of the terrain; and where slabs hang, of roofs as an altitude meets them
)
PEOPLE_SAMPLE_BYTES = (
    12  # the pixel of people under a sample of a cell, of rasters by day and by night
)
WORD_BYTES = (
    16  # of a cell at an altitude: which of up to 64 satellites it sees, twice if supersampled
)
SERIES_VALUE_BYTES = (
    5  # of a cell at an altitude and a time of a series: m, and whether it is within its limits
)
SUBCELL_BYTES = 60  # rasters of the supersampled surface, its tops for both directions, and the lidar's order of them
SPREAD_CELL_BYTES = 4 * 10 * 3  # about ten arrays of each of three metrics
# What the JAX forms of kernels take beside, as compiled for a GPU (benchmarks/cuda_compile.json).
SHADOW_GPU_BYTES = (
    64  # of a satellite over a cell of the tile and its halo: shadows are cast by doubling
)
LIDAR_GPU_WORD_BYTES = 4.4  # over flat ground: 32 results of a step, and a tenth
TERRAIN_GPU_BYTES = 400  # of a tile's own cell: the lidar's rays over terrain
GEOTIFF_CELL_BYTES = 14  # of a row of tiles, all across the region, while a GeoTIFF is made of it
PROGRAM_BYTES = 80 * 2**20  # the programs compiled for the tiles of one resolution
WORKER_BYTES = 700 * 2**20  # a worker process with everything imported, before its first tile
# Under Linux, by the file system of control groups: the file of a group's limit, and what it cannot give back.
GROUP_FILES = {
    "cgroup": ("memory.limit_in_bytes", ("total_rss", "total_shmem")),
    "cgroup2": ("memory.max", ("anon", "shmem")),
}
WORK_CELL_BYTES = 8  # on the disk, of a cell of the region: both its roofs, until maps are whole
LEAST_SHARE = 0.02  # on the disk, of the maps' values, as compressed as any city's were
MOST_SHARE = 1 + 4 / 3  # the same of noise: once in Zarr, once as GeoTIFFs with their overviews
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


def format_bytes(num_bytes: float) -> str:
    """Return a size as people read it."""
    if num_bytes < 2**30:
        return f"{num_bytes / 2**20:.0f} MiB" if num_bytes >= 2**20 else "less than 1 MiB"
    return (
        f"{num_bytes / 2**30:.1f} GiB"
        if num_bytes < 10 * 2**30
        else f"{num_bytes / 2**30:,.0f} GiB"
    )


def told_apart(*sizes: float) -> list[str]:
    """Return sizes as people read them, with the digits that tell them apart."""
    texts = [*map(format_bytes, sizes)]
    return texts if len({*texts}) == len(texts) else [f"{size / 2**20:,.3f} MiB" for size in sizes]


def shape_of_tiles(task: MapTask) -> tuple[int, int]:
    """Return rows and columns of the tiles of a region; settings decide it, never the machine."""
    if task.keeps_times:
        return tile_shape(task.region.shape)
    series_bytes = 4 * task.num_times * len(task.params.altitudes_m)
    return tile_shape(
        task.region.shape,
        int(min(MAX_SIDE, max(LEAST_SIDE, math.sqrt(SERIES_BYTES / series_bytes)))),
    )


def tile_bytes(task: MapTask, tile: Grid, around: Grid | None = None) -> int:
    """Return about how many bytes the work on one tile takes at its highest.

    Args:
      task: what the maps are made of.
      tile: a part of its region, or all of it.
      around: what is rasterised for it; left out, the halo of a tile that its neighbours hand shadows on to.
    """
    num_altitudes, num_rasters = (
        len(task.params.altitudes_m),
        task.has_terrain + (task.city.hanging == SLABS),
    )
    series_bytes = 0 if task.keeps_times else SERIES_VALUE_BYTES * task.num_times
    needed = _num_cells(around or task.with_halo(tile)) * (
        SURFACE_CELL_BYTES + TERRAIN_CELL_BYTES * num_rasters
    )
    for metric in task.metrics.values():
        reach = math.ceil(metric.reach_m(task.settings_of(metric)) / tile.resolution_m)
        needed += _num_cells(tile, reach) * metric.cell_bytes
        needed += (
            _num_cells(tile) * num_altitudes * (WORD_BYTES + series_bytes) * (TIME in metric.dims)
        )
    if task.city.blocks is not None and task.city.blocks.day_count is not None:
        needed += _num_cells(tile) * PEOPLE_SAMPLES**2 * PEOPLE_SAMPLE_BYTES
    if task.params.engine == "jax" and task.has_terrain and "lidar" in task.metrics:
        needed += _num_cells(tile) * TERRAIN_GPU_BYTES
    of_margin = SPREAD_CELL_BYTES * num_altitudes * bool(task.params.heights.height_samples)
    if task.params.oversample > 1 or task.params.gps.bounds:
        of_margin += SUBCELL_BYTES * task.params.oversample**2
    return needed + of_margin * _num_cells(task.with_margin(tile)) if of_margin else needed


def tile_gpu_bytes(task: MapTask, tile: Grid) -> int:
    """Return about how many bytes of a GPU's memory the work on one tile takes at its highest.

    Over flat ground the lidar there keeps a bit a step for every cell in its range. As words are bands of rows, each
    with a halo of its own, these bits are up to 32 times the cells around.
    """
    satellites = int(task.sky.is_in_view.sum(axis=1).max())
    steps = num_steps(tile.resolution_m, task.params.sections["lidar"].range_m)
    bands = replace(tile, num_rows=-(-tile.num_rows // WORD_BITS))
    flat = LIDAR_GPU_WORD_BYTES * steps * _num_cells(bands, steps - 1)
    lidar = TERRAIN_GPU_BYTES * _num_cells(tile) if task.has_terrain else flat
    shadows = SHADOW_GPU_BYTES * satellites * _num_cells(task.with_halo(tile))
    return int(tile_bytes(task, tile) + shadows + lidar * ("lidar" in task.metrics))


def maps_bytes(task: MapTask) -> int:
    """Return how many bytes the values of a region's maps are."""
    cells = _num_cells(task.region)
    return sum(
        cells
        * np.dtype(variable.dtype).itemsize
        * math.prod(task.sizes[dim] for dim in variable.dims)
        for variable in variables(task).values()
    )


def _num_cells(grid: Grid, halo: int = 0) -> int:
    return (grid.num_rows + 2 * halo) * (grid.num_cols + 2 * halo)


def free_bytes(root: Path = Path("/")) -> int:
    """Return how much memory this process may still take: what the machine has, or its control groups if that is less.

    Args:
      root: of the file system, where ``proc/self`` names the groups.
    """
    return min([psutil.virtual_memory().available, *_left_in_groups(root)])


def _left_in_groups(root: Path) -> list[int]:
    """Return what is left under each limit of a control group that holds this process, of version 1 or 2 (cgroups(7)).

    A group's limit holds for all groups in it, so every level counts, up to where the groups are mounted. In a
    container the group may not be found there by its name: the levels above it that are found, count.
    """
    left = []
    for level, kind in _group_levels(root):
        limit_file, held_names = GROUP_FILES[kind]
        with suppress(
            OSError, ValueError
        ):  # no group, one without a limit ("max"), or of other resources
            limit = int((level / limit_file).read_text())
            stat = dict(line.split() for line in (level / "memory.stat").read_text().splitlines())
            left.append(limit - sum(int(stat.get(name, 0)) for name in held_names))
    return left


def _group_levels(root: Path) -> Iterator[tuple[Path, str]]:
    """Yield the folders of this process's control groups and of those above, each with its kind of file system."""
    try:
        listed = (root / "proc/self/cgroup").read_text(errors="surrogateescape")
        mounts = (root / "proc/self/mountinfo").read_text(errors="surrogateescape").splitlines()
    except OSError:  # another system
        return
    groups = [line.split(":", 2) for line in listed.splitlines() if line.count(":") >= 2]
    names = {
        "cgroup2" if not of else "cgroup": name
        for _, of, name in groups
        if not of or "memory" in of.split(",")
    }
    for line in mounts:
        before, _, after = line.partition(" - ")
        kind, fields = after.split(" ")[0], before.split()
        if kind not in names or len(fields) < 5:
            continue
        top, place = map(_unescaped, fields[3:5])
        name, mounted = PurePosixPath(names[kind]), root / place.lstrip("/")
        within = (
            name.relative_to(top)
            if name.is_relative_to(top) and ".." not in name.parts
            else PurePosixPath()
        )
        for level in (within, *within.parents):
            yield mounted / level, kind


def _unescaped(field: str) -> str:
    """Return a field of ``mountinfo`` without its octal escapes."""
    return re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), field)


def gpu_free_bytes() -> int | None:
    """Return how much memory JAX may still take on its GPU; None where it computes on a CPU or does not say."""
    stats = jax.local_devices()[0].memory_stats() or {}
    return (
        int(stats["bytes_limit"] - stats.get("bytes_in_use", 0)) if "bytes_limit" in stats else None
    )


def check_fits(task: MapTask) -> None:
    """Raise InputError where the maps of a region take more memory than is free, made at once as `build_maps` does."""
    region, free = task.region, free_bytes()
    needed = (
        COMPILING_BYTES
        + PROGRAM_BYTES
        + tile_bytes(task, region, task.with_margin())
        + maps_bytes(task)
    )
    if needed > free:
        needed_text, free_text = told_apart(needed, free)
        raise InputError(
            f"the maps of {region.num_rows:,} x {region.num_cols:,} cells of {region.resolution_m:g} m need about "
            f"{needed_text} of memory at once and {free_text} are free: choose a smaller region, a "
            "coarser resolution_m or a shorter lidar range_m, or make them with `jaxurban maps`, which works tile by "
            "tile"
        )


def plan_run(
    tasks: Sequence[MapTask],
    ceiling_bytes: int | None = None,
    num_workers: int = 1,
    num_processes: int = 0,
) -> int:
    """Return how many tiles (and GeoTIFFs) to work on at a time, and say in the log what that takes.

    Args:
      tasks: made one after the other.
      ceiling_bytes: of all processes together; None for `DEFAULT_SHARE` of the free memory.
      num_workers: the most; each process works on as many tiles.
      num_processes: beside this one, that do the work; 0 where its threads do.

    Raises:
      InputError: not even one tile fits (or not one in each process), or none into the memory of JAX's GPU.
    """
    tile_most, gpu_most, num_tiles = 0, 0, 1
    for task in tasks:
        shape, region = shape_of_tiles(task), task.region
        tile = replace(region, num_rows=shape[0], num_cols=shape[1])
        num_tiles = max(
            num_tiles, -(-region.num_rows // shape[0]) * -(-region.num_cols // shape[1])
        )
        tile_most = max(
            tile_most, tile_bytes(task, tile), shape[0] * region.num_cols * GEOTIFF_CELL_BYTES
        )
        gpu_most = max(gpu_most, tile_gpu_bytes(task, tile))
    if tasks[0].params.engine != "numba" and (on_gpu := gpu_free_bytes()) is not None:
        if gpu_most > on_gpu:
            most_text, free_text = told_apart(gpu_most, on_gpu)
            raise InputError(
                f"a tile needs about {most_text} of the GPU's memory and {free_text} are free: end what else "
                "uses it, choose a shorter [lidar] range_m or fewer altitudes or times, or take --device cpu"
            )
        num_workers = min(num_workers, on_gpu // gpu_most)
    own, least = psutil.Process().memory_info().rss, num_processes or 1
    ceiling = int(own + DEFAULT_SHARE * free_bytes()) if ceiling_bytes is None else ceiling_bytes
    base = (
        own + len(tasks) * PROGRAM_BYTES * least + (num_processes * WORKER_BYTES or COMPILING_BYTES)
    )
    fitting = (ceiling - base) // tile_most
    if fitting < least:
        needed_text, most_text = told_apart(base + tile_most * least, ceiling)
        remedy = "fewer --workers" if num_processes > 1 else "a coarser [region] resolution_m"
        raise InputError(
            f"this job needs about {needed_text} of memory and may take {most_text}: raise --memory, or choose "
            f"{remedy}, a shorter [lidar] range_m or [risk] threshold_m, or fewer altitudes or times"
        )
    num_workers = min(num_workers, fitting) // least * least
    at_once = min(num_workers, max(num_tiles, least))
    LOG.info(
        f"{sum(_num_cells(task.region) for task in tasks):,} cells, tiles at a time: {at_once}; about "
        f"{format_bytes(base + at_once * tile_most)} of memory at most, of {format_bytes(ceiling)} allowed"
    )
    return num_workers


def disk_bytes(tasks: Sequence[MapTask]) -> tuple[int, int]:
    """Return how many bytes of disk a run takes at least and at most, its resolutions one after the other."""
    work = max(WORK_CELL_BYTES * _num_cells(task.region) for task in tasks)
    values = sum(map(maps_bytes, tasks))
    return int(work + LEAST_SHARE * values), int(work + MOST_SHARE * values)


def check_disk(tasks: Sequence[MapTask], folder: Path) -> None:
    """Say in the log what a run takes of the disk at its peak; what an earlier run left counts as free.

    Args:
      tasks: of the resolutions.
      folder: of the maps.

    Raises:
      InputError: the disk is too small even for compressible maps.
    """
    from jaxurban.io.store import GEOTIFF_FOLDER, ZARR_FOLDER  # imported here: it brings Dask

    files = (file for name in (ZARR_FOLDER, GEOTIFF_FOLDER) for file in (folder / name).rglob("*"))
    left = sum(file.stat().st_size for file in files if file.is_file())
    (least, most), free = disk_bytes(tasks), shutil.disk_usage(folder).free
    if least > free + left:
        least_text, free_text = told_apart(least, free)
        raise InputError(
            f"the maps need at least {least_text} of disk and {free_text} are free in {str(folder)!r}: "
            "use a smaller region, a coarser [region] resolution_m, or another folder"
        )
    span = " to ".join(dict.fromkeys(map(format_bytes, (least, most))))
    LOG.info(f"disk at the peak: {span}, of {format_bytes(free + left)} free")
