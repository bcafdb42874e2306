"""The datasets that hold metric maps: their variables, units, coordinates and attributes."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import xarray as xr
from xarray.indexes import PandasIndex

from jaxurban.io.attributes import CAVEAT, IN_OBSTACLES
from jaxurban.maps.height_uncertainty import SPREAD
from jaxurban.maps.task import MapTask
from jaxurban.metrics.availability import SERIES, TimeTotals
from jaxurban.metrics.base import ALTITUDE, TIME, UNDERSIDE
from jaxurban.metrics.gps import DOPS, WEIGHTED_DOPS
from jaxurban.metrics.protection import LEVELS, WITHIN_LIMITS
from jaxurban.world.city import SLABS, joined_credits

PLANE = ("y", "x")
CONVENTIONS = "CF-1.11"
UNITS = {  # of what is not a metric's m
    "density": "km-2",
    **dict.fromkeys(("roof", "roof_touched", UNDERSIDE, "terrain", *LEVELS), "m"),
}
OF_DOP = {"g": "geometric", "p": "position", "h": "horizontal", "v": "vertical", "t": "time"}
LONG_NAMES = {  # of what is not a metric's m
    "obstacle": "cells inside obstacles",
    "obstacle_share": "share of height samples with an obstacle",
    "density": "people per square kilometre",
    "num_visible": "satellites in view",
    **{name: f"{OF_DOP[name[-4]]} dilution of precision" for name in DOPS},
    **{name: f"{OF_DOP[name[-4]]} dilution of precision, weighted by elevation" for name in WEIGHTED_DOPS},
    "hpl": "horizontal protection level",
    "vpl": "vertical protection level",
    WITHIN_LIMITS: "both protection levels within their alert limits",
    "roof": "height of the roof over the cell's centre above the ground",
    "roof_touched": "height of the highest roof that shares area with the cell above the ground",
    "roof_guessed": "the height of the highest roof that touches the cell, or is over its centre, is guessed",
    UNDERSIDE: "height of the lowest underside of what hangs over the cell's centre above the ground",
    "terrain": "elevation of the ground",
    "has_data": "something is known of the cell",
}
STANDARD_NAMES = {"terrain": "surface_altitude", "has_data": "status_flag"}
OVER_TIME = {
    "availability": "share of times above the threshold",
    "median": "median over time",
    "p05": "5th percentile over time",
}
OVER_HEIGHTS = dict(zip(SPREAD, ("mean", "standard deviation", "5th percentile", "95th percentile"), strict=True))


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
        if TIME in metric.dims and metric.is_monotone and task.params.gps_bounds:
            names |= dict.fromkeys((f"{name}_lower", f"{name}_upper"), (dims, np.float32))
        if name in task.spread_metrics:
            names |= dict.fromkeys((f"{name}_{what}" for what in SPREAD), (dims, np.float32))
    if task.params.height_samples:
        names["obstacle_share"] = (flown, np.float32)
    names |= dict.fromkeys(("roof", "roof_touched"), (PLANE, np.float32))
    if task.has_guessed_roofs:
        names["roof_guessed"] = (PLANE, np.bool_)
    if task.city.hanging == SLABS and task.city.buildings is not None:
        names[UNDERSIDE] = (PLANE, np.float32)
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
        "risk_threshold_m": params.risk.threshold_m,
        "risk_distance": params.risk.distance,
    }
    if len(set(task.sky.systems)) > 1:
        attrs["gps_clocks"] = params.gps.clocks
    if attribution:
        attrs["attribution"] = attribution
    if task.population is not None:
        names = np.asarray(params.times_of_day, np.dtypes.StringDType())
        coords["time_of_day"] = _held(("time_of_day",), names, {"long_name": "time of day"})
        per = "block" if params.population.quantity == "count" else "km2"
        attrs[f"pop_norm_per_{per}"] = [float(value) for value in task.population.norm_per_km2]
    if not task.keeps_times:
        attrs["gps_availability_threshold"] = params.gps.availability_threshold
    sizes = {name: coord.size for name, coord in coords.items()}
    held = variables(task).items()
    data = {name: _held(dims, make(tuple(sizes[dim] for dim in dims), kind)) for name, (dims, kind) in held}
    ds = _described(xr.Dataset(data, _indexed(coords), attrs), task)
    if "protection" in task.metrics:
        settings = task.settings_of(task.metrics["protection"])
        for name in ("horizontal_alert_limit_m", "vertical_alert_limit_m"):
            ds.attrs[name] = float(getattr(settings, name))
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
    return _described(ds, task)


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


def _described(ds: xr.Dataset, task: MapTask) -> xr.Dataset:
    units, meanings = dict(UNITS), {"obstacle": "a roof reaches this altitude"}
    titles = dict(LONG_NAMES)
    in_obstacles = {
        **dict.fromkeys((*DOPS, *WEIGHTED_DOPS, *LEVELS), "inf"),
        **dict.fromkeys(("num_visible", WITHIN_LIMITS), "0"),
    }
    caveats: dict[str, str] = {}
    for name, metric in task.metrics.items():
        units[name], meanings[name], label = metric.unit, metric.one_means, metric.label
        titles |= {name: label, f"{name}_lower": f"{label}, at least", f"{name}_upper": f"{label}, at most"}
        titles |= {f"{name}_{what}": f"{label}, {of} over uncertain heights" for what, of in OVER_HEIGHTS.items()}
        if name not in task.layers and ALTITUDE in metric.dims:
            in_obstacles |= dict.fromkeys((name, f"{name}_lower", f"{name}_upper"), "0")
        if TIME in metric.dims:
            meanings |= dict.fromkeys((f"{name}_median", f"{name}_p05", f"{name}_epoch_mean"), metric.one_means)
            at_every = f"{LONG_NAMES[metric.available]}," if metric.available else f"m_{name} is above the threshold"
            meanings[f"{name}_availability"] = f"{at_every} at every epoch"
            if not task.keeps_times:
                titles |= {f"{name}_{what}": f"{label}, {of}" for what, of in OVER_TIME.items()}
                if metric.available:
                    titles[f"{name}_availability"] = f"{label}, share of times with {LONG_NAMES[metric.available]}"
                titles[f"{name}_epoch_mean"] = f"{label}, mean over free cells"
                titles[f"{name}_worst_time"] = f"{label}, time of the least mean over free cells"
                in_obstacles |= dict.fromkeys((f"{name}_{what}" for what in SERIES), "0")
        if metric.caveat:
            own = [str(held) for held in ds.data_vars if held in metric.variables or str(held).startswith(f"{name}_")]
            caveats |= dict.fromkeys(own, metric.caveat)
    for name in map(str, ds.data_vars):
        found = {
            "long_name": titles.get(name, name),
            CAVEAT: caveats.get(name),
            "standard_name": STANDARD_NAMES.get(name),
        }
        if name != "has_data" and ds[name].dtype.kind != "M":  # times have units of their own
            found |= {"units": units.get(name, "1"), "one_means": meanings.get(name)}
        if {"y", "x"} <= set(ds[name].dims):
            found |= {"grid_mapping": "spatial_ref", IN_OBSTACLES: in_obstacles.get(name)}
        ds[name].attrs |= {key: value for key, value in found.items() if value is not None}
    if "pop_norm_per_block" in ds.attrs:
        ds["population"].attrs["one_means"] = "as many people in the block as the norm (pop_norm_per_block)"
    return ds
