"""What two sets of maps share: the cells, altitudes, times and layers that both hold."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyproj
import xarray as xr

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.population import NORMS
from jaxurban.public import listed

CELLS = {"y", "x"}


class OneMap(NamedTuple):
    """One map of a layer: its altitude, time and time of day, None where the layer does not vary along it."""

    altitude_m: float | None = None
    time: str | None = None
    time_of_day: str | None = None


def shared_part(a: MetricMaps, b: MetricMaps) -> tuple[MetricMaps, MetricMaps]:
    """Return two sets of maps, each cut to what both hold: the same cells, altitudes, times of day and layers.

    Times are the ones that both hold; where each holds a single time, these two form a pair even if they differ.
    Layers are kept if both have them along the same dimensions.

    Raises:
      InputError: another CRS or resolution, no cell, altitude or layer that both hold, or times that do not pair.
    """
    grid, other = a.grid, b.grid
    if pyproj.CRS(grid.crs) != pyproj.CRS(other.crs) or grid.resolution_m != other.resolution_m:
        raise InputError(
            f"A's cells are {grid.resolution_m:g} m wide in {grid.crs} and B's {other.resolution_m:g} m in "
            f"{other.crs}, so that none is in both: make B again with [region] crs = {grid.crs!r} and resolution_m = "
            f"{grid.resolution_m:g} (a list makes several, of which --resolution chooses)"
        )

    # Cells, altitudes and times of day that both hold. Cells are numbered from the origin of the CRS, so that those of
    # one CRS and resolution coincide, to the bit, wherever they meet.
    ds_a, ds_b = xr.align(a.ds, b.ds, join="inner", exclude=[TIME])
    if not ds_a.sizes["x"] * ds_a.sizes["y"]:
        raise InputError("the maps share no cell: compare maps of regions that overlap")
    if not ds_a.sizes[ALTITUDE]:
        of_a = listed([f"{z_m:g}" for z_m in a.altitudes_m])
        of_b = listed([f"{z_m:g}" for z_m in b.altitudes_m])
        raise InputError(
            f"the maps share no altitude: A holds {of_a} m and B {of_b} m; add one of A's to B's scenario"
        )

    # Layers along the same dimensions, none of which is empty; and the times, which need to pair only where a layer
    # varies with them.
    layers = [
        name
        for name, array in ds_a.data_vars.items()
        if set(array.dims) >= CELLS
        and name in ds_b
        and set(ds_b[name].dims) == set(array.dims)
        and array.size
    ]
    times_a: Sequence[str] = a.times
    times_b: Sequence[str] = b.times
    if any(TIME in ds_a[name].dims for name in layers):
        times_a, times_b = _paired(a, b)
    return _part(a, ds_a[layers], times_a, grid.crs), _part(b, ds_b[layers], times_b, grid.crs)


def paired_times(a: MetricMaps, b: MetricMaps) -> dict[str, str]:
    """Return the time of B beside each of A, of maps from `shared_part`; empty where no layer varies with the time."""
    has_times = any(TIME in array.dims for array in a.ds.data_vars.values())
    return dict(zip(a.times, b.times, strict=True)) if has_times else {}


def _part(maps: MetricMaps, ds: xr.Dataset, times: Sequence[str], crs: str) -> MetricMaps:
    """Return the part of maps that a dataset holds, at some of their times, in another name of their CRS.

    Attributes that hold one number for each time of day are cut with it.
    """
    if TIME in ds.dims:
        ds = ds.isel({TIME: [maps.times.index(time) for time in times]})
    attrs: dict[str, Any] = {"crs": crs}
    if TIME_OF_DAY in ds.dims:
        days = [maps.times_of_day.index(day) for day in ds[TIME_OF_DAY].values]
        attrs |= {
            norm: np.atleast_1d(ds.attrs[norm])[days].tolist() for norm in NORMS if norm in ds.attrs
        }
    return MetricMaps(ds.assign_attrs(attrs), maps.obstacles)


def _paired(a: MetricMaps, b: MetricMaps) -> tuple[Sequence[str], Sequence[str]]:
    """Return the times of A and those of B beside them: the same ones, or both maps' single time.

    Raises:
      InputError: no time is in both, and one of them holds several.
    """
    if len(a.times) == len(b.times) == 1:
        return a.times, b.times
    shared = [time for time in a.times if time in b.times]
    if shared:
        return shared, shared
    raise InputError(
        f"the maps share no time, A holds {listed(a.times)} and B {listed(b.times)}: compare maps of a single time "
        "each, as in MetricMaps(maps.ds.isel(time=[0]))"
    )


def population_norms(maps: MetricMaps) -> dict[str, float]:
    """Return by which number of people, per km2 or per block, the population of each time of day is divided."""
    for name in NORMS:
        if name in maps.ds.attrs:
            norms = np.atleast_1d(maps.ds.attrs[name]).astype(float)
            return dict(zip(maps.times_of_day, norms.tolist(), strict=False))
    return {}
