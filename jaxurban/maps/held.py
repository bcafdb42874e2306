"""HeldMaps: finished maps of fewer altitudes, times or layers, whose values larger ones take over."""

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jaxurban.io.store import open_whole
from jaxurban.maps.recipe import MapLayer
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY

Place = tuple[int, ...]


@dataclass(frozen=True)
class HeldMaps:
    """Which maps of a task are there already, in a Zarr of the same grid and tiles.

    Attributes:
      path: of the Zarr.
      places: by metric and place along its dims in the task, the place in the Zarr.
      variables: of each metric that is held.
    """

    path: Path
    places: Mapping[tuple[str, Place], Place]
    variables: Mapping[str, tuple[str, ...]]

    @classmethod
    def of(cls, path: Path, task: MapTask, times: Collection[str]) -> "HeldMaps":
        """Return what a Zarr holds of a task's maps.

        Args:
          path: of the Zarr.
          task: of the larger maps.
          times: UTC times at which the satellites stand as they did for the Zarr.
        """
        ds = open_whole(path)
        held: dict[str, list[Any]] = {
            TIME: [f"{time}Z" for time in np.datetime_as_string(ds["time"].values, unit="s")],
            ALTITUDE: [float(z_m) for z_m in ds["altitude"].values],
            TIME_OF_DAY: [str(item) for item in ds["time_of_day"].values] if TIME_OF_DAY in ds.coords else [],
        }
        wanted: dict[str, list[Any]] = {
            TIME: [time if time in times else None for time in task.sky.times],
            ALTITUDE: list(task.params.altitudes_m),
            TIME_OF_DAY: list(task.params.times_of_day),
        }
        places, variables = {}, {}
        for name, metric in task.metrics.items():
            names = (name, *metric.also)
            if not all(each in ds for each in names):
                continue
            variables[name] = names
            for place in np.ndindex(*(task.sizes[dim] for dim in metric.dims)):
                values = [(dim, wanted[dim][index]) for dim, index in zip(metric.dims, place, strict=True)]
                if all(value in held[dim] for dim, value in values):
                    places[name, place] = tuple(held[dim].index(value) for dim, value in values)
        return cls(path, places, variables)

    @property
    def digest(self) -> str:
        """What stands for these places: work that counted on others is not to be gone on with."""
        return hashlib.sha256(repr(sorted(self.places.items())).encode()).hexdigest()[:16]

    @cached_property
    def _ds(self) -> xr.Dataset:
        return open_whole(self.path)

    def layers(self, window: tuple[slice, slice]) -> Iterator[MapLayer]:
        """Yield the held maps of a tile, the window of the region that it reports."""
        rows, cols = window
        for (metric, place), held in self.places.items():
            for name in self.variables[metric]:
                array = self._ds[name].variable
                yield MapLayer(name, place, array[(*held, rows, cols)].values)
