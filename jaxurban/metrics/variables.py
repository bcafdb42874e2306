"""The maps that no metric makes, and the statistics of those that one does: what each is, in one table."""

from dataclasses import replace

import numpy as np

from jaxurban.metrics.base import ALTITUDE, TIME, UNDERSIDE, Metric, Scale, Variable

FREE_COLOUR, BUILT_COLOUR, GUESSED_COLOUR, NO_DATA_COLOUR = "#f4f4ee", "#4a4a4a", "#d55e00", "#bdbdbd"
ROOF_SCALE = Scale(high=None, stretch="sqrt", zero="no building")
GROUND_SCALE = Scale(low=None, high=None)
SERIES = {  # of a metric at many times, behind its name
    "availability": "share of times above the threshold",
    "median": "median over time",
    "p05": "5th percentile over time",
}
BOUNDS = {"lower": "at least", "upper": "at most"}
SPREAD = {
    "mean": "mean over uncertain heights",
    "std": "standard deviation over uncertain heights",
    "p05": "5th percentile over uncertain heights",
    "p95": "95th percentile over uncertain heights",
}

OBSTACLE = Variable(
    "obstacle",
    "cells inside obstacles",
    dtype=np.uint8,
    one_means="a roof reaches this altitude",
    title="Obstacles",
    classes=(("free", FREE_COLOUR), ("obstacle", BUILT_COLOUR)),
    dims=(ALTITUDE,),
)
NO_METRICS = {
    variable.name: variable
    for variable in (
        OBSTACLE,
        Variable("obstacle_share", "share of height samples with an obstacle", dims=(ALTITUDE,)),
        Variable(
            "roof",
            "height of the roof over the cell's centre above the ground",
            "m",
            scale=ROOF_SCALE,
            title="Roof height",
        ),
        Variable(
            "roof_touched",
            "height of the highest roof that shares area with the cell above the ground",
            "m",
            scale=ROOF_SCALE,
            title="Highest roof that touches a cell",
        ),
        Variable(
            "roof_guessed",
            "the height of the highest roof that touches the cell, or is over its centre, is guessed",
            dtype=np.bool_,
            classes=(("height known, or no roof", FREE_COLOUR), ("height guessed", GUESSED_COLOUR)),
        ),
        Variable(
            UNDERSIDE,
            "height of the lowest underside of what hangs over the cell's centre above the ground",
            "m",
            scale=ROOF_SCALE,
        ),
        Variable(
            "terrain",
            "elevation of the ground",
            "m",
            scale=GROUND_SCALE,
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


def _derived(metric: Metric, titles: dict[str, str]) -> dict[str, Variable]:
    """Return variables that are made of a metric's own, by name."""
    own = metric.variables[metric.name]
    made = {f"{own.name}_{what}": f"{own.long_name}, {said}" for what, said in titles.items()}
    return {name: replace(own, name=name, long_name=long_name, one_means="") for name, long_name in made.items()}


def series_of(metric: Metric) -> dict[str, Variable]:
    """Return what is kept of a metric over a long series of times, cell by cell."""
    found = _derived(metric, SERIES)
    at_every = f"m_{metric.name} is above the threshold"
    if metric.available:
        at_every = f"{metric.variables[metric.available].long_name},"
        share = f"{metric.label}, share of times with {at_every.rstrip(',')}"
        found[f"{metric.name}_availability"] = replace(found[f"{metric.name}_availability"], long_name=share)
    meanings = (f"{at_every} at every epoch", metric.one_means, metric.one_means)
    dims = tuple(dim for dim in metric.dims if dim != TIME)
    return {
        name: replace(variable, dims=dims, one_means=meaning)
        for (name, variable), meaning in zip(found.items(), meanings, strict=True)
    }


def of_region(metric: Metric) -> dict[str, Variable]:
    """Return what is kept of a metric over a long series of times and a whole region; of no cells."""
    mean, worst = _derived(
        metric, {"epoch_mean": "mean over free cells", "worst_time": "time of the least mean over free cells"}
    ).values()
    made = replace(mean, one_means=metric.one_means), replace(worst, unit="")
    return {variable.name: replace(variable, inside=None) for variable in made}


def bounds_of(metric: Metric) -> dict[str, Variable]:
    """Return what brackets a metric."""
    return _derived(metric, BOUNDS)


def spread_of(metric: Metric) -> dict[str, Variable]:
    """Return the spread of a metric over uncertain heights, which has values where only the known roofs stand."""
    return {name: replace(variable, inside=None) for name, variable in _derived(metric, SPREAD).items()}


def variables_of(metric: Metric, is_series: bool = False) -> dict[str, Variable]:
    """Return all that maps may hold of a metric: at every time, or statistics over a series of times."""
    if is_series:
        return series_of(metric) | of_region(metric)
    return {**metric.variables, **bounds_of(metric), **spread_of(metric)}
