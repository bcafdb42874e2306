"""What a run may use, and how its work keeps under that."""

import os
import shutil
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxurban.city import City
from jaxurban.cluster import cluster_client
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.layers import MapParams, margin_of
from jaxurban.memory import MemoryPlan, detail_bytes, gib, plan_memory, shape_of_tiles, tile_bytes
from jaxurban.sky import Sky

SCRATCH_BYTES_PER_CELL = 16  # rasters of an unfinished run, and one plain GeoTIFF: the least disk that a run takes


@dataclass(frozen=True)
class Resources:
    """What a run may use.

    Attributes:
      memory_bytes: ceiling on the memory of all processes together; None for half of what is free.
      num_processes: worker processes of a new local Dask cluster; None to work in threads of this process.
      cluster: address of a Dask scheduler, whose workers see the output folder under the same path, instead.
    """

    memory_bytes: int | None = None
    num_processes: int | None = None
    cluster: str | None = None

    def __post_init__(self) -> None:
        if self.num_processes is not None and self.num_processes < 1:
            raise InputError(f"--workers must be at least 1, got {self.num_processes}")
        if self.num_processes is not None and self.cluster is not None:
            raise InputError("give either --workers, for a cluster of this machine's own, or --cluster, not both")

    def client(self) -> Any:
        """Return a context that gives the client of a Dask cluster, None where threads do the work."""
        if self.cluster is None and self.num_processes is None:
            return nullcontext()
        return cluster_client(self.cluster, self.num_processes)


def num_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def plan_run(
    city: City, grids: list[Grid], skies: list[Sky], params: MapParams, resources: Resources, folder: Path
) -> MemoryPlan:
    """Return how a run of some regions, one after the other, keeps under its memory ceiling.

    Raises:
      InputError: it cannot, or the disk is too small.
    """
    num_epochs, most_bytes, num_tiles = len(skies[0].times), 0, 1
    for grid, sky in zip(grids, skies, strict=True):
        shape = shape_of_tiles(grid.shape, params, num_epochs)
        tile = replace(grid, num_rows=shape[0], num_cols=shape[1])
        num_tiles = max(num_tiles, -(-grid.num_rows // shape[0]) * -(-grid.num_cols // shape[1]))
        plain = tile_bytes(shape, grid.resolution_m, params, num_epochs, city.terrain is not None)
        most_bytes = max(most_bytes, plain + detail_bytes(margin_of(city, tile, sky, params), params))
    if resources.cluster is not None:  # the workers' machines are not ours to measure
        return MemoryPlan(0, 0, num_cores())
    plan = plan_memory(
        resources.memory_bytes,
        most_bytes,
        resources.num_processes or num_cores(),
        has_processes=resources.num_processes is not None,
        num_resolutions=len(grids),
        num_tiles=num_tiles,
    )
    disk_bytes = SCRATCH_BYTES_PER_CELL * max(grid.num_rows * grid.num_cols for grid in grids)
    free_bytes = shutil.disk_usage(folder).free
    if disk_bytes > free_bytes:
        raise InputError(
            f"the maps need at least {gib(disk_bytes)} of disk and {gib(free_bytes)} are free in {str(folder)!r}: use "
            "a smaller region, a coarser [region] resolution_m, or another folder"
        )
    return plan


def plan_sentence(grids: list[Grid], plan: MemoryPlan) -> str:
    """Return what a run tells of its size and memory before it begins."""
    cells = sum(grid.num_rows * grid.num_cols for grid in grids)
    if not plan.ceiling_bytes:
        return f"{cells:,} cells on a Dask cluster"
    return (
        f"{cells:,} cells, {plan.num_workers} tile{'s' * (plan.num_workers > 1)} at a time: about "
        f"{gib(plan.needed_bytes)} of memory at most, of {gib(plan.ceiling_bytes)} allowed"
    )
