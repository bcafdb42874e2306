"""The datasets that hold metric maps: their variables, units, coordinates and attributes."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import xarray as xr
from xarray.indexes import PandasIndex

from jaxurban.maps.task import MapTask
from jaxurban.metrics.availability import TimeTotals
from jaxurban.metrics.base import TIME, UNDERSIDE, Variable
from jaxurban.metrics.variables import CAVEAT, NO_METRICS, derived
from jaxurban.world.city import SLABS, joined_credits

PLANE = ("y", "x")
CONVENTIONS = "CF-1.11"


def variables(task: MapTask) -> dict[str, Variable]:
    """Return every variable that the maps of a task hold, by name."""
    found = {"obstacle": NO_METRICS["obstacle"]}
    for name, metric in task.metrics.items():
        if TIME in metric.dims and not task.keeps_times:
            found |= derived(metric)["series"]
            continue
        found |= metric.variables
        if TIME in metric.dims and metric.is_monotone and task.params.gps.bounds:
            found |= derived(metric)["bounds"]
        if name in task.spread_metrics:
            found |= derived(metric)["spread"]
    are_made = {
        "obstacle_share": task.params.heights.height_samples,
        "roof_guessed": task.has_guessed_roofs,
        UNDERSIDE: task.city.hanging == SLABS and task.city.buildings is not None,
        "terrain": task.has_terrain,
    }
    return found | {name: variable for name, variable in NO_METRICS.items() if are_made.get(name, True)}


def empty_dataset(task: MapTask, make: Callable[[tuple[int, ...], np.dtype], object] = np.zeros) -> xr.Dataset:
    """Return the dataset that the maps of a task go into, with coordinates and attributes, all values zero.

    Args:
      task: what the maps are made of.
      make: gives the array of a shape and a type.
    """
    region, params = task.region, task.params
    attribution = joined_credits(task.city.attribution, *(layer.credit for layer in task.layers.values()))
    times = np.array([time.removesuffix("Z") for time in task.sky.times], "datetime64[ns]")
    heights = {"units": "m", "positive": "up", "reference": "ground below (AGL)"}
    coords = {
        "y": _axis("y", region.y_m, "Y", "projection_y_coordinate", "northing of the cell's centre", units="m"),
        "x": _axis("x", region.x_m, "X", "projection_x_coordinate", "easting of the cell's centre", units="m"),
        "altitude": _axis("altitude", np.asarray(params.altitudes_m, float), "Z", "height", "above ground", **heights),
        "time": _axis("time", times, "T", "time", "UTC"),
        "spatial_ref": _held((), np.asarray(0), pyproj.CRS(region.crs).to_cf()),
    }
    attrs: dict[str, object] = {
        "Conventions": CONVENTIONS,
        "crs": region.crs,
        "resolution_m": region.resolution_m,
        "first_row": region.first_row,
        "first_col": region.first_col,
        "satellites": ", ".join(task.sky.names),
        "constellations": ", ".join(sorted(set(task.sky.systems))),
    }
    for metric in task.metrics.values():
        attrs |= {name: getattr(task.settings_of(metric), setting) for name, setting in metric.recorded.items()}
    if len(set(task.sky.systems)) > 1:
        attrs["gps_clocks"] = params.gps.clocks
    if attribution:
        attrs["attribution"] = attribution
    if task.population is not None:
        names = np.asarray(params.population.times_of_day, np.dtypes.StringDType())
        coords["time_of_day"] = _held(("time_of_day",), names, {"long_name": "time of day"})
        per = "block" if params.population.quantity == "count" else "km2"
        attrs[f"pop_norm_per_{per}"] = [float(value) for value in task.population.norm_per_km2]
    if not task.keeps_times:
        attrs["gps_availability_threshold"] = params.gps.availability_threshold
    sizes = {name: coord.size for name, coord in coords.items()}
    held = variables(task)
    data = {}
    for name, variable in held.items():
        dims = (*variable.dims, *PLANE)
        data[name] = _held(dims, make(tuple(sizes[dim] for dim in dims), np.dtype(variable.dtype)))
    ds = xr.Dataset(data, _indexed(coords), attrs)
    for name, variable in held.items():
        ds[name].attrs |= _attributes(variable, ds[name])
    if "pop_norm_per_block" in ds.attrs:
        ds["population"].attrs["one_means"] = "as many people in the block as the norm (pop_norm_per_block)"
    for name, layer in task.layers.items():
        ds[name].attrs["layer"] = json.dumps(layer.record)
    return ds


def with_series(ds: xr.Dataset, task: MapTask, totals: Mapping[str, TimeTotals]) -> xr.Dataset:
    """Return a dataset of statistics over time with what only the whole region tells: mean and worst time.

    Args:
      ds: the maps.
      task: what they are made of.
      totals: the region's, by metric.
    """
    for name, sums in totals.items():
        mean, worst = (("time", "altitude"), sums.mean), ("altitude", ds["time"].values[sums.worst])
        ds = ds.assign({f"{name}_epoch_mean": mean, f"{name}_worst_time": worst})
        for each, variable in derived(task.metrics[name])["region"].items():
            ds[each].attrs |= _attributes(variable, ds[each])
    return ds


def _held(dims: tuple[str, ...], values: Any, attrs: Mapping[str, Any] | None = None) -> xr.Variable:
    """Return a variable of an array as it is; xarray's usual way loads Dask, 0.3 s, to ask whether it is one of its."""
    return xr.Variable(dims, values, attrs, fastpath=True)


def _indexed(coords: Mapping[str, xr.Variable]) -> xr.Coordinates:
    """Return coordinates with an index for each axis (made here, as xarray's usual way loads Dask for these too)."""
    indexes = {
        name: PandasIndex(pd.Index(coord.values), name, coord_dtype=coord.dtype)
        for name, coord in coords.items()
        if coord.dims
    }
    axes = {name: index.create_variables(coords)[name] for name, index in indexes.items()}
    return xr.Coordinates({**coords, **axes}, indexes)


def _axis(name: str, values: np.ndarray, axis: str, standard_name: str, long_name: str, **more: str) -> xr.Variable:
    return _held((name,), values, {"standard_name": standard_name, "long_name": long_name, "axis": axis, **more})


def _attributes(variable: Variable, array: xr.DataArray) -> dict[str, str]:
    """Return what files say of a variable."""
    is_time = array.dtype.kind == "M"  # which has units of its own
    found = {
        "long_name": variable.long_name,
        CAVEAT: variable.caveat,
        "standard_name": variable.standard_name,
        "units": "" if is_time else variable.unit,
        "one_means": variable.one_means,
        "grid_mapping": "spatial_ref" if {*PLANE} <= {*array.dims} else "",
    }
    return {key: value for key, value in found.items() if value}
