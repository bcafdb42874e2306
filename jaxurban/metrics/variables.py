"""The maps that no metric makes, and the statistics of those that one does: what each is, in one table."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from jaxurban.metrics.base import ALTITUDE, TIME, UNDERSIDE, Metric, Scale, Variable

FREE_COLOUR, BUILT_COLOUR, GUESSED_COLOUR, NO_DATA_COLOUR = "#f4f4ee", "#4a4a4a", "#d55e00", "#bdbdbd"
CAVEAT = "comment"  # attribute: what whoever reads the values must know; the name is that of the CF conventions
NEEDED = ("obstacle", "has_data")  # without these maps it is not a folder of maps
SERIES = ("availability", "median", "p05")  # what is kept of a long series, behind the metric's name
_roof = partial(Variable, unit="m", scale=Scale(high=None, stretch="sqrt", zero="no building"))

NO_METRICS = {
    variable.name: variable
    for variable in (
        Variable(
            "obstacle",
            "cells inside obstacles",
            dtype=np.uint8,
            one_means="a roof reaches this altitude",
            title="Obstacles",
            classes=(("free", FREE_COLOUR), ("obstacle", BUILT_COLOUR)),
            dims=(ALTITUDE,),
        ),
        Variable("obstacle_share", "share of height samples with an obstacle", dims=(ALTITUDE,)),
        _roof("roof", "height of the roof over the cell's centre above the ground", title="Roof height"),
        _roof(
            "roof_touched",
            "height of the highest roof that shares area with the cell above the ground",
            title="Highest roof that touches a cell",
        ),
        Variable(
            "roof_guessed",
            "the height of the highest roof that touches the cell, or is over its centre, is guessed",
            dtype=np.bool_,
            classes=(("height known, or no roof", FREE_COLOUR), ("height guessed", GUESSED_COLOUR)),
        ),
        _roof(UNDERSIDE, "height of the lowest underside of what hangs over the cell's centre above the ground"),
        Variable(
            "terrain",
            "elevation of the ground",
            "m",
            scale=Scale(low=None, high=None),
            title="Terrain",
            standard_name="surface_altitude",
        ),
        Variable(
            "has_data",
            "something is known of the cell",
            "",
            dtype=np.bool_,
            classes=(("no data", NO_DATA_COLOUR), ("data", FREE_COLOUR)),
            standard_name="status_flag",
        ),
    )
}


def derived(metric: Metric) -> dict[str, dict[str, Variable]]:
    """Return what is made of a metric's own map, by kind and by name.

    ``"series"``: over many times, cell by cell; ``"region"``: the same over all cells; ``"bounds"``: what brackets it;
    ``"spread"``: over uncertain heights.
    """
    own, dims = metric.variables[metric.name], tuple(dim for dim in metric.dims if dim != TIME)
    share, always_so = "above the threshold", f"m_{own.name} is above the threshold"
    if metric.available:
        share, always_so = f"with {(said := metric.variables[metric.available].long_name)}", f"{said},"
    uncertain = "over uncertain heights"
    kinds: dict[str, dict[str, tuple[str, str]]] = {  # what it is, and what 1 means
        "series": {
            "availability": (f"share of times {share}", f"{always_so} at every epoch"),
            "median": ("median over time", own.one_means),
            "p05": ("5th percentile over time", own.one_means),
        },
        "region": {
            "epoch_mean": ("mean over free cells", own.one_means),
            "worst_time": ("time of the least mean over free cells", ""),
        },
        "bounds": {"lower": ("at least", ""), "upper": ("at most", "")},
        "spread": {
            "mean": (f"mean {uncertain}", ""),
            "std": (f"standard deviation {uncertain}", ""),
            "p05": (f"5th percentile {uncertain}", ""),
            "p95": (f"95th percentile {uncertain}", ""),
        },
    }
    return {
        kind: {
            (name := f"{own.name}_{what}"): replace(
                own,
                name=name,
                long_name=f"{own.long_name}, {said}",
                one_means=means,
                dims=dims if kind == "series" else own.dims,
            )
            for what, (said, means) in rows.items()
        }
        for kind, rows in kinds.items()
    }


def names_in(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the names in an attribute, which holds them as one text: NetCDF 3 takes no lists of texts."""
    return [part for part in attributes.get(name, "").split(", ") if part]


def no_value(dtype: np.dtype) -> Any:
    """Return what stands for no value in files: NaN, the highest unsigned number; None where there is nothing such."""
    return {"f": np.nan, "u": np.iinfo(dtype).max if dtype.kind == "u" else None}.get(dtype.kind)
