"""What two sets of maps share: the cells, altitudes, times and layers that both hold."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pyproj

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.metrics.population import NORMS
from jaxurban.public import listed
from jaxurban.world.grid import Grid


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
    grid = _shared_grid(a.grid, b.grid)
    altitudes_m = [z_m for z_m in a.altitudes_m if z_m in b.altitudes_m]
    if not altitudes_m:
        of_a = listed([f"{z_m:g}" for z_m in a.altitudes_m])
        of_b = listed([f"{z_m:g}" for z_m in b.altitudes_m])
        raise InputError(
            f"the maps share no altitude: A holds {of_a} m and B {of_b} m; add one of A's to B's scenario"
        )

    # The dimensions of each layer that both hold, by its name. A layer that varies with the time of day needs one that
    # both hold.
    days = [day for day in a.times_of_day if day in b.times_of_day]
    layers = {}
    for name, array in a.ds.data_vars.items():
        dims = set(array.dims)
        is_in_both = name in b.ds and set(b.ds[name].dims) == dims
        if {"y", "x"} <= dims and is_in_both and (days or TIME_OF_DAY not in dims):
            layers[name] = dims

    # Times need to pair only where a layer varies with them.
    times_a = a.times
    times_b = b.times
    if any(TIME in dims for dims in layers.values()):
        pairs = _paired(a, b)
        times_a = tuple(pairs)
        times_b = tuple(pairs.values())
    shared: dict[str, Sequence[Any]] = {ALTITUDE: altitudes_m, TIME_OF_DAY: days}
    return (
        _part(a, grid, [*layers], shared | {TIME: times_a}),
        _part(b, grid, [*layers], shared | {TIME: times_b}),
    )


def paired_times(a: MetricMaps, b: MetricMaps) -> dict[str, str]:
    """Return the time of B beside each of A, of maps from `shared_part`; empty where no layer varies with the time."""
    has_times = any(TIME in array.dims for array in a.ds.data_vars.values())
    return dict(zip(a.times, b.times, strict=True)) if has_times else {}


def _part(
    maps: MetricMaps, grid: Grid, layers: Sequence[Any], shared: Mapping[str, Sequence[Any]]
) -> MetricMaps:
    """Return the part of maps on some of their cells, with some of their layers, altitudes and times.

    Args:
      maps: to be cut.
      grid: the cells to keep, all within the maps' own; its CRS replaces the maps' name of the same CRS.
      layers: names of the variables to keep.
      shared: by dimension the values to keep, which the maps hold.
    """
    # The layers, and the place of each value to keep along its dimension.
    ds = maps.ds.drop_vars([name for name in maps.ds.data_vars if name not in layers])
    rows, cols = grid.window_in(replace(maps.grid, crs=grid.crs))
    values: dict[str, Sequence[Any]] = {
        ALTITUDE: maps.altitudes_m,
        TIME: maps.times,
        TIME_OF_DAY: maps.times_of_day,
    }
    indices: dict[str, Any] = {"y": rows, "x": cols}
    for dim in values.keys() & set(ds.dims):
        indices[dim] = [values[dim].index(value) for value in shared[dim]]

    # Attributes that hold one number for each time of day are cut with it.
    attrs = dict(ds.attrs, crs=grid.crs)
    for norm in NORMS:
        if norm in attrs and TIME_OF_DAY in indices:
            attrs[norm] = np.atleast_1d(attrs[norm])[indices[TIME_OF_DAY]].tolist()
    return MetricMaps(ds.isel(indices).assign_attrs(attrs), maps.obstacles)


def _shared_grid(a: Grid, b: Grid) -> Grid:
    """Return the grid of the cells that two grids share.

    Cells are numbered from the origin of the CRS, so cells of one CRS and one resolution coincide wherever they meet.

    Raises:
      InputError: another CRS or resolution, or no cell that both hold.
    """
    if pyproj.CRS(a.crs) != pyproj.CRS(b.crs) or a.resolution_m != b.resolution_m:
        raise InputError(
            f"A's cells are {a.resolution_m:g} m wide in {a.crs} and B's {b.resolution_m:g} m in {b.crs}, so that none "
            f"is in both: make B again with [region] crs = {a.crs!r} and resolution_m = {a.resolution_m:g} (a list "
            "makes several, of which --resolution chooses)"
        )
    first_a = [a.first_row, a.first_col]
    first_b = [b.first_row, b.first_col]
    first = np.maximum(first_a, first_b)
    shape = np.minimum(np.add(first_a, a.shape), np.add(first_b, b.shape)) - first
    if shape.min() <= 0:
        raise InputError("the maps share no cell: compare maps of regions that overlap")
    return Grid(a.crs, a.resolution_m, *first.tolist(), *shape.tolist())


def _paired(a: MetricMaps, b: MetricMaps) -> dict[str, str]:
    """Return the time of B that stands beside each time of A, by A's time: the same one, or both maps' single time.

    Raises:
      InputError: no time is in both, and one of them holds several.
    """
    if len(a.times) == len(b.times) == 1:
        return {a.times[0]: b.times[0]}
    shared = {time: time for time in a.times if time in b.times}
    if shared:
        return shared
    raise InputError(
        f"the maps share no time, A holds {listed(a.times)} and B {listed(b.times)}: compare maps of a single time "
        "each, as in MetricMaps(maps.ds.isel(time=[0]))"
    )
