"""Whether the disk can hold the maps of a run at all."""

import math
import shutil
from collections.abc import Sequence
from pathlib import Path

from jaxurban.errors import InputError
from jaxurban.io.store import GEOTIFF_FOLDER, ZARR_FOLDER
from jaxurban.maps.memory import maps_bytes, told_bytes
from jaxurban.maps.task import MapTask

WORK_CELL_BYTES = 8  # of a cell of the region: roofs as they are, and the roof that touches it, until maps are whole
LEAST_SHARE = 0.02  # of the maps' values, as compressed as any city's were (docs/scale.md)


def least_bytes(tasks: Sequence[MapTask]) -> int:
    """Return how many bytes of disk a run takes at least, its resolutions one after the other."""
    work = max(WORK_CELL_BYTES * math.prod(task.region.shape) for task in tasks)
    return int(work + LEAST_SHARE * sum(map(maps_bytes, tasks)))


def check_disk(tasks: Sequence[MapTask], folder: Path) -> None:
    """Raise InputError where a disk is too small even for compressible maps; what an earlier run left counts as free.

    Args:
      tasks: of the resolutions.
      folder: of the maps.
    """
    files = (file for name in (ZARR_FOLDER, GEOTIFF_FOLDER) for file in (folder / name).rglob("*"))
    left = sum(file.stat().st_size for file in files if file.is_file())
    least, free = least_bytes(tasks), shutil.disk_usage(folder).free
    if least > free + left:
        raise InputError(
            f"the maps need at least {told_bytes(least)} of disk and {told_bytes(free)} are free in {str(folder)!r}: "
            "use a smaller region, a coarser [region] resolution_m, or another folder"
        )
