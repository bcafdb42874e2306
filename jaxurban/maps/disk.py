"""How much disk a run of maps takes: the files that stay, and what lies beside them until they are whole."""

import math
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from jaxurban.errors import InputError
from jaxurban.io.geotiff import geotiff_names
from jaxurban.io.store import GEOTIFF_FOLDER, ZARR_FOLDER
from jaxurban.maps.dataset import PLANE, variables
from jaxurban.maps.memory import shape_of_tiles, told_bytes
from jaxurban.maps.task import MapTask
from jaxurban.progress import LOG
from jaxurban.world.tiling import Tiling

RASTER_BYTES = 4  # of a cell of a tile, in the work folder as it is: its roof, and as much of its terrain
OWN_RASTER_BYTES = 4  # of a cell of the region's tiles: the roof that touches it, and as much of its block
EDGE_BYTES = 4  # of a cell along a tile's border, for each satellite that casts shadows
# Compressed, of a cell of a layer, by its type. Measured (docs/scale.md): a quarter of it to one and a half times as
# much, by city and by size of cells.
ZARR_BYTES = {"f": 0.3, "u": 0.06, "b": 0.01}
GEOTIFF_BYTES = {"f": 0.4, "u": 0.08, "b": 0.02}
PLAIN_BYTES = 4 * 4 / 3  # of a cell of a map that becomes a GeoTIFF, and of its overviews: not compressed yet
LEAST_SHARE = 0.25  # of what is foretold of files: where not even that is free, no run begins


def scratch_bytes(task: MapTask) -> int:
    """Return how many bytes the work folder of a resolution takes before its maps are whole, the maps left out."""
    tiling = Tiling.over(task.region, task.with_margin(), shape_of_tiles(task))
    every = RASTER_BYTES * (1 + task.has_terrain)
    own = OWN_RASTER_BYTES * (1 + (task.city.blocks is not None))
    num_satellites = sum(len(task.satellites_at(number)) for number in range(task.num_times))
    needed, inner = 0, set(tiling.region_tiles)
    for tile in tiling.tiles:
        grid = tiling.grid_of(tile)
        needed += math.prod(grid.shape) * (every + own * (tile in inner))
        needed += sum(grid.shape) * EDGE_BYTES * num_satellites
    return needed


def num_values(task: MapTask, layers: Sequence[str] = ()) -> tuple[Counter[str], Counter[str]]:
    """Return how many values of each kind of type the Zarr and the GeoTIFFs of a resolution hold.

    Args:
      task: what the maps are made of.
      layers: variables that are GeoTIFFs too, beside obstacles and the metrics of the cost.
    """
    cells = math.prod(task.region.shape)
    held = {name: about for name, about in variables(task).items() if about[0][-2:] == PLANE}
    counts = Counter[str](), Counter[str]()
    for count, names in zip(counts, (held, geotiff_names(held, task.metrics, layers)), strict=True):
        for dims, kind in (held[name] for name in names):
            count[kind.kind] += cells * math.prod(task.sizes[dim] for dim in dims[:-2])
    return counts


def file_bytes(task: MapTask, layers: Sequence[str] = ()) -> tuple[float, float]:
    """Return about how many bytes the Zarr and the GeoTIFFs of a resolution take; arguments as for `num_values`."""
    of_zarr, of_geotiffs = num_values(task, layers)
    return (
        sum(ZARR_BYTES[kind] * num for kind, num in of_zarr.items()),
        sum(GEOTIFF_BYTES[kind] * num for kind, num in of_geotiffs.items()),
    )


def disk_bytes(tasks: Sequence[MapTask], layers: Sequence[str] = (), num_workers: int = 1, share: float = 1.0) -> int:
    """Return about how many bytes a run takes at its highest, its resolutions one after the other.

    Args:
      tasks: of the resolutions.
      layers: as for `file_bytes`.
      num_workers: each of which writes a GeoTIFF at a time.
      share: of what is foretold of files that counts.
    """
    kept, most = 0.0, 0.0
    for task in tasks:
        of_zarr, of_geotiffs = (share * each for each in file_bytes(task, layers))
        plain = PLAIN_BYTES * math.prod(task.region.shape) * num_workers
        most = max(most, kept + of_zarr + max(scratch_bytes(task), of_geotiffs + plain))
        kept += of_zarr + of_geotiffs
    return int(most)


def check_disk(tasks: Sequence[MapTask], folder: Path, layers: Sequence[str] = (), num_workers: int = 1) -> int:
    """Return about how many bytes of disk a run takes at its highest; what an earlier one left there counts as free.

    The log warns of a disk that is too small for them.

    Raises:
      InputError: the disk of ``folder`` is too small even for compressible maps.
    """
    files = (file for name in (ZARR_FOLDER, GEOTIFF_FOLDER) for file in (folder / name).rglob("*"))
    held = sum(file.stat().st_size for file in files if file.is_file())
    least, free = disk_bytes(tasks, layers, num_workers, LEAST_SHARE), shutil.disk_usage(folder).free
    if least > free + held:
        raise InputError(
            f"the maps need at least {told_bytes(least)} of disk and {told_bytes(free)} are free in {str(folder)!r}: "
            "use a smaller region, a coarser [region] resolution_m, or another folder"
        )
    about = disk_bytes(tasks, layers, num_workers)
    if about > free + held:
        LOG.warning(
            f"the maps take about {told_bytes(about)} of disk and {told_bytes(free)} are free in {str(folder)!r}: the "
            "run begins, as they may become smaller, but may end for want of space; the same command then goes on"
        )
    return about
