"""How long a run of maps takes, foretold from its cells before the first of them is made."""

import math
from collections.abc import Sequence

from jaxurban.maps.disk import num_values
from jaxurban.maps.task import MapTask

# Nanoseconds of a core, measured on Tokyo and the synthetic city at 2 to 10 m (docs/scale.md).
SURFACE_NS = 200  # of a cell: roofs read, burnt and put together
SATELLITE_NS = 4  # of a cell at an altitude and a time, for each satellite: its shadow, and its part of the DOPs
LIDAR_NS = 50  # of a cell at an altitude
TERRAIN_LIDAR_NS = 2_000  # the same over terrain
OTHER_NS = 15  # of a cell of another metric's map
ZARR_NS = 13  # of a value
GEOTIFF_NS = 30  # of a value: taken from the Zarr, halved for the overviews, compressed, read back


def foretold_s(tasks: Sequence[MapTask], layers: Sequence[str] = (), num_workers: int = 1) -> float:
    """Return about how many seconds the maps take once the sources are read: half to twice that, by city and machine.

    Args:
      tasks: of the resolutions.
      layers: as for `jaxurban.maps.disk.file_bytes`.
      num_workers: cores that work side by side.
    """
    return sum(_core_ns(task, layers) for task in tasks) * 1e-9 / num_workers


def _core_ns(task: MapTask, layers: Sequence[str]) -> float:
    cells = math.prod(task.region.shape)
    of_zarr, of_geotiffs = (sum(by_kind.values()) for by_kind in num_values(task, layers))
    at_altitudes = cells * task.params.oversample**2 * len(task.params.altitudes_m) * (1 + task.params.height_samples)
    satellites = sum(len(task.satellites_at(number)) for number in range(task.num_times))
    lidar_ns = TERRAIN_LIDAR_NS if task.has_terrain else LIDAR_NS
    return (
        cells * task.params.oversample**2 * SURFACE_NS
        + at_altitudes * (satellites * SATELLITE_NS + lidar_ns * ("lidar" in task.metrics))
        + cells * sum(math.prod(task.sizes[dim] for dim in metric.dims) for metric in task.metrics.values()) * OTHER_NS
        + of_zarr * ZARR_NS
        + of_geotiffs * GEOTIFF_NS
    )


def told(seconds: float) -> str:
    """Return a time from `foretold_s` as people read it."""
    if seconds < 10:
        return "a few seconds"
    if seconds < 90:
        return f"about {round(seconds, -1):.0f} s"
    return f"about {seconds / 60:.0f} min" if seconds < 5400 else f"about {seconds / 3600:.1f} h"
