"""The datasets that hold metric maps: their variables, units, coordinates and attributes."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pyproj
import xarray as xr

from jaxurban.maps.height_uncertainty import SPREAD
from jaxurban.maps.task import MapTask
from jaxurban.metrics.availability import SERIES, TimeTotals
from jaxurban.metrics.base import ALTITUDE, TIME

PLANE = ("y", "x")
UNITS = {  # of what is not a metric's m
    "density": "km-2",
    **dict.fromkeys(("roof", "roof_touched", "terrain"), "m"),
}


def variables(task: MapTask) -> dict[str, tuple[tuple[str, ...], np.dtype]]:
    """Return dims and type of every variable that the maps of a task hold."""
    flown = (ALTITUDE, *PLANE)
    names: dict[str, tuple[tuple[str, ...], type]] = {"obstacle": (flown, np.uint8)}
    for name, metric in task.metrics.items():
        dims = (*metric.dims, *PLANE)
        if TIME in metric.dims and not task.keeps_times:
            names |= dict.fromkeys((f"{name}_{what}" for what in SERIES), (dims[1:], np.float32))
            continue
        names |= {name: (dims, np.float32)} | {other: (dims, kind) for other, kind in metric.also.items()}
        if TIME in metric.dims and task.params.gps_bounds:
            names |= dict.fromkeys((f"{name}_lower", f"{name}_upper"), (dims, np.float32))
        if name in task.spread_metrics:
            names |= dict.fromkeys((f"{name}_{what}" for what in SPREAD), (dims, np.float32))
    if task.params.height_samples:
        names["obstacle_share"] = (flown, np.float32)
    names |= dict.fromkeys(("roof", "roof_touched"), (PLANE, np.float32))
    if task.draws_guesses:
        names["roof_guessed"] = (PLANE, np.bool_)
    if task.has_terrain:
        names["terrain"] = (PLANE, np.float32)
    names["has_data"] = (PLANE, np.bool_)
    return {name: (dims, np.dtype(kind)) for name, (dims, kind) in names.items()}


def empty_dataset(task: MapTask, make: Callable[[tuple[int, ...], np.dtype], object] = np.zeros) -> xr.Dataset:
    """Return the dataset that the maps of a task go into, with coordinates and attributes, all values zero.

    Args:
      task: what the maps are made of.
      make: gives the array of a shape and a type.
    """
    region, params, attribution = task.region, task.params, task.city.attribution
    coords: dict[str, Any] = {
        "y": ("y", region.y_m, {"units": "m", "standard_name": "projection_y_coordinate"}),
        "x": ("x", region.x_m, {"units": "m", "standard_name": "projection_x_coordinate"}),
        "altitude": ("altitude", np.asarray(params.altitudes_m, float), {"units": "m", "long_name": "above ground"}),
        "time": ("time", np.array([time.removesuffix("Z") for time in task.sky.times], "datetime64[ns]")),
        "spatial_ref": ((), 0, pyproj.CRS(region.crs).to_cf()),
    }
    attrs: dict[str, object] = {
        "crs": region.crs,
        "resolution_m": region.resolution_m,
        "first_row": region.first_row,
        "first_col": region.first_col,
        "satellites": list(task.sky.names),
        "risk_threshold_m": params.risk.threshold_m,
        "risk_distance": params.risk.distance,
    }
    if attribution:
        attrs["attribution"] = attribution
    if task.population is not None:
        coords["time_of_day"] = ("time_of_day", np.asarray(params.times_of_day, np.dtypes.StringDType()))
        is_count = params.population.quantity == "count"
        norm_name = "pop_norm_per_block" if is_count else "pop_norm_per_km2"
        attrs[norm_name] = [float(value) for value in task.population.norm_per_km2]
    if not task.keeps_times:
        attrs["gps_availability_threshold"] = params.gps.availability_threshold
    sizes = {
        "y": region.num_rows,
        "x": region.num_cols,
        **{name: len(coord[1]) for name, coord in coords.items() if coord[0]},
    }
    held = variables(task).items()
    data = {name: (dims, make(tuple(sizes[dim] for dim in dims), kind)) for name, (dims, kind) in held}
    ds = _described(xr.Dataset(data, coords, attrs), task)
    for name, layer in task.layers.items():
        ds[name].attrs["layer"] = layer.record
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
    return _described(ds, task)


def _described(ds: xr.Dataset, task: MapTask) -> xr.Dataset:
    units, meanings = dict(UNITS), {"obstacle": "a roof reaches this altitude"}
    for name, metric in task.metrics.items():
        units[name], meanings[name] = metric.unit, metric.one_means
        if TIME in metric.dims:
            meanings |= dict.fromkeys((f"{name}_median", f"{name}_p05", f"{name}_epoch_mean"), metric.one_means)
            meanings[f"{name}_availability"] = f"m_{name} is above the threshold at every epoch"
    for name in (str(variable) for variable in ds.data_vars):
        if name != "has_data" and ds[name].dtype.kind != "M":  # times have units of their own
            ds[name].attrs["units"] = units.get(name, "1")
            if {"y", "x"} <= set(ds[name].dims):
                ds[name].attrs["grid_mapping"] = "spatial_ref"
            if name in meanings:
                ds[name].attrs["one_means"] = meanings[name]
    if "pop_norm_per_block" in ds.attrs:
        ds["population"].attrs["one_means"] = "as many people in the block as the norm (pop_norm_per_block)"
    return ds
