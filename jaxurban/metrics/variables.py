"""The maps that no metric makes, and the statistics over time of those that one does: what and how."""

from collections.abc import Container, Hashable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from jaxurban.metrics.base import (
    ALTITUDE,
    TIME,
    UNDERSIDE,
    AnyArray,
    Metric,
    Scale,
    Variable,
)
from jaxurban.world.footprints import UNKNOWN
from jaxurban.world.kinds import GROUPS, OTHERS

FREE_COLOUR, BUILT_COLOUR = "#f4f4ee", "#4a4a4a"
GUESSED_CELL_COLOUR, NO_DATA_COLOUR = "#d55e00", "#bdbdbd"
GROUP_COLOURS = {  # of `GROUPS`; apart from each other and from free cells for the colour-blind
    "buildings": BUILT_COLOUR,
    "trees": "#006d2c",
    "wires": "#8e44ad",
    OTHERS: "#ffc20a",
    GROUPS[UNKNOWN]: "#f26b21",
}
GROUP_NUMBERS = {kind: [*GROUP_COLOURS].index(group) for kind, group in GROUPS.items()}
KIND_COLOURS = {kind: GROUP_COLOURS[group] for kind, group in GROUPS.items()}
CAVEAT = "comment"  # attribute: what whoever reads the values must know; the name is that of the CF conventions
ROOF_KIND = "roof_kind"
NEEDED = ("obstacle", "has_data")  # without these maps it is not a folder of maps
# What is kept of a long series, behind the metric's name: of one that paths pay for, and of one that they do not.
SERIES = ("availability", "median", "p05")
HIGHEST = "highest"
STORED_AS = ("median", HIGHEST)  # what a long series keeps in place of a metric
_bound = partial(
    Variable,
    unit="m",
    scale=Scale(high=None, stretch="sqrt", zero="height known, or no roof"),
    is_averaged=False,
)
_roof = partial(Variable, unit="m", scale=Scale(high=None, stretch="sqrt", zero="no roof"))

AUXILIARY_VARIABLES = {
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
        _roof(
            "roof",
            "height of the roof over the cell's centre above the ground",
            title="Roof height",
        ),
        _roof(
            "roof_touched",
            "height of the highest roof that shares area with the cell above the ground",
            title="Highest roof that touches a cell",
        ),
        Variable(
            "roof_guessed",
            "the height of the highest roof that touches the cell, or is over its centre, is guessed",
            title="Guessed heights",
            dtype=np.bool_,
            classes=(
                ("height known, or no roof", FREE_COLOUR),
                ("height guessed", GUESSED_CELL_COLOUR),
            ),
        ),
        _bound(
            "roof_limit",
            "height above the ground that no roof of guessed height that touches the cell exceeds",
            title="Bound of guessed heights",
        ),
        _bound(
            "roof_likely",
            "height above the ground that 99 % of the roofs of guessed height as those that touch the cell keep below",
            title="Likely most of guessed heights",
        ),
        Variable(
            ROOF_KIND,
            "what has the highest roof that touches the cell",
            "",
            dtype=np.uint8,
            classes=(("nothing", FREE_COLOUR), *KIND_COLOURS.items()),
            title="What stands",
            standard_name="status_flag",
        ),
        _roof(
            UNDERSIDE,
            "height of the lowest underside of what hangs over the cell's centre above the ground",
        ),
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
    """Return the variables that are made of a metric's own map, by kind and by name.

    Of a metric that costs nothing there is its highest value over the times alone, under ``"series"``.

    ``"series"`` are statistics of a cell over many times, ``"bounds"`` what brackets the map, ``"spread"`` statistics
    over uncertain heights.
    """
    own = metric.variables[metric.name]

    # What makes a position available: m above the threshold, or a variable of the metric.
    share_text = "above the threshold"
    always_text = f"m_{own.name} is above the threshold"
    if metric.available:
        condition = metric.variables[metric.available].long_name
        share_text = f"with {condition}"
        always_text = f"{condition},"

    # By suffix of the name: what the variable is, and what a value of 1 means ("" where that needs no word).
    uncertain = "over uncertain heights"
    series = {
        "availability": (f"share of times {share_text}", f"{always_text} at every epoch"),
        "median": ("median over time", own.one_means),
        "p05": ("5th percentile over time", own.one_means),
    }
    bounds = {"lower": ("at least", ""), "upper": ("at most", "")}
    spread = {
        "mean": (f"mean {uncertain}", ""),
        "std": (f"standard deviation {uncertain}", ""),
        "p05": (f"5th percentile {uncertain}", ""),
        "p95": (f"95th percentile {uncertain}", ""),
    }

    without_time = tuple(dim for dim in metric.dims if dim != TIME)
    if not metric.is_cost:
        highest = {HIGHEST: ("highest over time", "")}
        over_time = _variants(replace(own, dims=without_time), highest)
        return {"series": over_time, "bounds": {}, "spread": {}}
    return {
        "series": _variants(replace(own, dims=without_time), series),
        "bounds": _variants(own, bounds),
        "spread": _variants(own, spread),
    }


def _variants(own: Variable, texts: Mapping[str, tuple[str, str]]) -> dict[str, Variable]:
    """Return variables like a metric's own, by name.

    Args:
      own: the metric's variable.
      texts: by the suffix of each name, what the variable is and what a value of 1 means.
    """
    variants = {}
    for suffix, (text, one_means) in texts.items():
        name = f"{own.name}_{suffix}"
        long_name = f"{own.long_name}, {text}"
        variants[name] = replace(own, name=name, long_name=long_name, one_means=one_means)
    return variants


def stored_name(name: str, variables: Container[Hashable]) -> str:
    """Return which of the variables of maps holds a metric: its own, or what a long series keeps in its place.

    Args:
      name: of the metric; it comes back where the maps do not hold it.
      variables: the names in the maps.
    """
    names = name, *(f"{name}_{suffix}" for suffix in STORED_AS)
    return next((each for each in names if each in variables), name)


def names_in(attributes: Mapping[str, Any], name: str) -> list[str]:
    """Return the names in the attribute ``name``, one text as NetCDF 3 takes no lists; none if it is missing."""
    return [part for part in attributes.get(name, "").split(", ") if part]


def no_value(dtype: np.dtype) -> Any:
    """Return what stands for no value in files, by type: NaN of floats, the highest unsigned integer, else None."""
    if dtype.kind == "u":
        return np.iinfo(dtype).max
    return np.nan if dtype.kind == "f" else None


LOW_SHARE = 0.05  # of the times: the percentile kept beside the median
CELLS_AT_ONCE = 2**13  # a block's values at all times stay in a core's cache


def series_statistics(
    m: np.ndarray, availability_threshold: float, is_available: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Return statistics over time of each cell, float32 ``[...]``, by the names of `SERIES`.

    ``availability`` is the share of times whose m is above the threshold, ``median`` the median, ``p05`` the value
    that 5 % of the times stay below. Median and p05 interpolate linearly between two times (definition 7 of Hyndman
    and Fan 1996). Inside obstacles, where m is 0 at every time, all three are 0. No gradient.

    Args:
      m: ``[T, ...]`` metric at each time, any axes of cells behind.
      availability_threshold: m above which a position counts as available.
      is_available: ``[T, ...]`` uint8: 1 where a position is available, whatever m is; left out, m decides.
    """
    num_times, *shape = m.shape
    flat = m.reshape(num_times, -1)
    num_cells = flat.shape[1]
    available = None if is_available is None else is_available.reshape(num_times, -1)
    statistics = {name: np.empty(num_cells, np.float32) for name in SERIES}
    for start in range(0, num_cells, CELLS_AT_ONCE):
        block = slice(start, start + CELLS_AT_ONCE)
        # ``[C, T]``: a sort along contiguous memory takes a quarter of the time of a partition, and a fourteenth of a
        # sort along the first axis.
        ordered = np.sort(np.ascontiguousarray(flat[:, block].T), axis=1)
        counted = ordered > availability_threshold if available is None else available[:, block].T
        for name, values in statistics_of_ordered(ordered, counted).items():
            statistics[name][block] = values
    return {name: values.reshape(shape) for name, values in statistics.items()}


def statistics_of_ordered(ordered: AnyArray, counted: AnyArray) -> dict[str, AnyArray]:
    """Return the same of values ``[..., T]`` that ascend along T; ``counted`` is True where a position is available."""
    return {
        "availability": counted.mean(axis=-1),
        "median": _quantile(ordered, 0.5),
        "p05": _quantile(ordered, LOW_SHARE),
    }


def _quantile(ordered: AnyArray, share: float) -> AnyArray:
    """Return a quantile along the last axis, interpolated linearly between two values.

    Args:
      ordered: ``[..., T]`` values, ascending along T.
      share: of the values of a row that lie below the quantile, 0 to 1.
    """
    last = ordered.shape[-1] - 1
    position = share * last
    below = int(position)
    low = ordered[..., below]
    high = ordered[..., min(below + 1, last)]
    return low + np.float32(position - below) * (high - low)
