"""A mission in numbers: metres without a fix, people overflown, exposure and cost, and the cheapest route instead."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter

from jaxurban.errors import InputError
from jaxurban.flights.legs import Flight
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.kernels.tolerances import AT_LIMIT
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.clearance import reaches_m
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.finish import measured
from jaxurban.paths.places import XY
from jaxurban.paths.plan import cost_map
from jaxurban.paths.profile import clearances_on, people_below, values_on
from jaxurban.paths.route_report import CLEARANCE, OVER_ROOF
from jaxurban.paths.steps import Steps

WINDOW_M = 1000.0  # of the densest stretch
FEW = 16  # of so many steps one is in a first look


def figures_of(
    flight: Flight,
    maps: MetricMaps,
    times: Sequence[str | None],
    time_of_day: str | None,
    swath_m: float,
) -> dict[str, Any]:
    """Return the length of a mission, its metres without a fix, the people below it and its clearances, by name.

    They are measured as those of a planned route are (`explain`); clearances are of cells, and leave out take-off,
    landing and what leads straight up or down. Beside them stand the metres where the fix or the people are not known,
    what lies off the maps included, and where the fix is first and last lost and the densest kilometre begins and ends.
    What the maps do not hold is left out.

    Args:
      flight: the mission over the maps.
      maps: the maps.
      times: of the GPS maps: ``no_fix_m`` is of the worst, ``no_fix_by_time_m`` of each. None is the first.
      time_of_day: of the population map; the first if None.
      swath_m: width of the strip in which people are counted.
    """
    steps = flight.steps
    length_m = steps.length_m
    on_maps_m = float(length_m.sum())
    off_m = max(0.0, round(flight.length_m - on_maps_m, 3))
    figures: dict[str, Any] = {"length_m": flight.length_m, "on_maps_m": on_maps_m}

    # Metres without a fix, at each time; those where the fix is not known are of the time that knows least.
    if FIX in maps.ds:
        lost, open_m = [], []
        for time in times:
            hdop = values_on(maps, FIX, steps, time, time_of_day)
            lost.append(np.isinf(hdop))
            open_m.append(float(np.isnan(hdop) @ length_m))
        no_fix_m = [float(is_lost @ length_m) for is_lost in lost]
        names = [time or maps.times[0] for time in times]
        figures |= {
            "no_fix_m": max(no_fix_m),
            "fix_unknown_m": max(open_m) + off_m,
            "no_fix_by_time_m": dict(zip(names, no_fix_m, strict=True)),
        }
        lost_m = steps.along_m[lost[np.argmax(no_fix_m)]]
        if len(lost_m):
            figures |= {"no_fix_from_m": float(lost_m.min()), "no_fix_to_m": float(lost_m.max())}

    # People below the strip, and metres where they are not known.
    if "density" in maps.ds:
        density = values_on(maps, "density", steps, None, time_of_day)
        people = people_below(np.nan_to_num(density), steps, swath_m)
        unknown_m = float(length_m[np.isnan(density)].sum()) + off_m
        figures |= {"people_overflown": float(people.sum()), "people_unknown_m": unknown_m}
        figures |= densest_of(people, steps)

    # Clearances: of a few steps, and of all that may be nearer to an obstacle.
    is_known = np.isfinite(steps.z_m).all(axis=1)
    steps = steps.take(is_known & ~flight.is_on_site(steps))
    some = steps.take(np.arange(0, len(steps.leg), FEW))
    away_m = clearances_on(maps, some)[CLEARANCE].min(initial=np.inf)
    near = clearances_on(maps, steps, away_m + AT_LIMIT)
    least = {
        CLEARANCE: near[CLEARANCE].min(initial=away_m),
        OVER_ROOF: np.fmin.reduce(near[OVER_ROOF], initial=np.inf),
    }
    return figures | {name: float(value) for name, value in least.items() if np.isfinite(value)}


def densest_of(people: np.ndarray, steps: Steps) -> dict[str, float]:
    """Return the most people below any kilometre of a mission, and where along the mission it begins and ends.

    Args:
      people: ``[P]`` below each step.
      steps: ``P`` of them. The kilometre is measured on the ground, and begins where a step does.
    """
    over_m = np.append(0.0, np.cumsum(steps.over_m))  # on the ground, at the begin of each step
    people_before = np.append(0.0, np.cumsum(people))
    people_in_km = np.interp(over_m + WINDOW_M, over_m, people_before) - people_before
    densest = np.argmax(people_in_km.round(6))  # the first of those as dense, whatever rounds
    along_m = np.append(steps.along_m[:, 0], steps.along_m.max(initial=0.0))
    return {
        "densest_km_people": float(people_in_km[densest]),
        "densest_km_from_m": float(along_m[densest]),
        "densest_km_to_m": float(np.interp(over_m[densest] + WINDOW_M, over_m, along_m)),
    }


def costs_of(
    flight: Flight,
    maps: MetricMaps,
    weights: WeightsLike,
    constraints: Constraints,
    time: str | None,
    time_of_day: str | None,
) -> dict[str, Any]:
    """Return what the way out of a mission costs, by layer too, and what the cheapest route in its place would cost.

    The way out ends where the mission first returns home; what a jump repeats, climbs and landings are left out too.
    All is costed at its median height, within the maps' altitudes. Where it has no cost, or no route can be compared
    with it, figures are missing, and ``cost_note`` says why.

    Args:
      flight: the mission over the maps.
      maps: the maps.
      weights: of the cost; what they leave out is as in the maps' scenario.
      constraints: that the cheapest route keeps. The mission is costed as it is, wherever it leads.
      time, time_of_day: of the maps; the first if None.
    """
    # The height, and the corners of the way out as the cost map takes them.
    grid = maps.grid
    way_out = list(takewhile(lambda leg: leg.kind != "return", flight.mission.legs))
    is_out = flight.steps.leg < len(way_out)
    moves = is_out & (flight.steps.over_m > 0)  # and not only straight up or down
    if not moves.any():
        return {"cost_note": "No leg leads over the maps, so there is no cost."}
    median_m = np.nanmedian(flight.steps.z_m[moves]).round(2)
    at_m = float(np.clip(median_m, min(maps.altitudes_m), max(maps.altitudes_m)))
    ends = [
        place[:2]
        for leg in way_out
        if not leg.is_variant and leg.kind != "jump"
        for place in (leg.start, leg.end)
    ]
    points_m = grid.xy_at(np.array(ends)) - grid.bounds_m[:2]
    figures: dict[str, Any] = {"compared_at_m": at_m}
    side_m = np.array(grid.shape[::-1]) * grid.resolution_m
    if not ((points_m >= 0) & (points_m < side_m)).all():
        return figures | {"cost_note": "The mission leaves the maps, so it has no cost."}

    # What it costs: on a map without a closed cell, as it may lead through some.
    limited_map = cost_map(
        maps, at_m, weights=weights, time=time, time_of_day=time_of_day, constraints=constraints
    )
    is_free = np.ones_like(limited_map.is_free)
    open_map = replace(limited_map, is_free=is_free, constraints=Constraints(clearance_m=0.0))
    way = measured(open_map, points_m)
    figures |= {name: way[name] for name in ("cost", "cost_by_layer", "exposure_by_layer")}
    try:
        return figures | savings_of(limited_map, points_m)
    except InputError as error:
        return figures | {"cost_note": f"No route to compare with: {error}."}


def savings_of(limited_map: CostMap, points_m: np.ndarray) -> dict[str, float]:
    """Return what the cheapest route in the place of a way out costs, and by how much less than the way.

    Both lead from cell to cell between the same ends: the way through the cells that it crosses and those beside them,
    the route through these and all that are as clear (`cells_as_clear`). So a planned route costs here what it was
    planned at, also where it was simplified within half a cell.

    Args:
      limited_map: at the height of the way, with its limits.
      points_m: ``[N, 2]`` the corners of the way, x, y in metres from the map's southwest corner.

    Raises:
      InputError: no route can be compared with the way; a clause says why.
    """
    # The way by cells.
    grid, is_free = limited_map.grid, limited_map.is_free
    start_m, goal_m = points_m[[0, -1]] + grid.bounds_m[:2]
    crossed = crossed_cells(points_m, grid.resolution_m)
    is_own = np.zeros_like(is_free)
    is_own[crossed.row, crossed.col] = True
    is_own &= is_free
    is_open = maximum_filter(is_own, 3) & is_free
    way = replace(limited_map, is_free=is_open).plan(XY(*start_m), XY(*goal_m))
    if not way.status.has_path:
        raise InputError("the mission passes where no route at its height may")
    if way.cost == 0:
        raise InputError("the mission ends where it starts, or costs nothing")

    # The cheapest route.
    is_open = is_open | (cells_as_clear(limited_map, is_own) & is_free)
    cheapest = replace(limited_map, is_free=is_open).plan(XY(*start_m), XY(*goal_m))
    saved = max(0.0, way.cost - cheapest.cost)  # and not rounding
    return {
        "cost_by_cells": way.cost,
        "cheapest_cost": cheapest.cost,
        "cheapest_length_m": cheapest.length_m,
        "saved_cost": saved,
        "saved_share": saved / way.cost,
    }


def cells_as_clear(limited_map: CostMap, is_own: np.ndarray) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that keep the clearances, horizontal and vertical, that all of a mission's keep.

    No roof in them is higher than the highest below the mission. What is higher than that, and what reaches the height
    of the mission, is nowhere nearer to them than to the nearest cell of the mission. Distances are those between
    squares, by which clearances close cells; heights are above the ground of each cell.

    Args:
      limited_map: at the height of the mission, with its limits.
      is_own: ``[Y, X]`` the cells of the mission.
    """
    limits = limited_map.constraints
    roof_m = np.maximum(*reaches_m(limited_map.maps, limits.horizontal_m, limits.of_unknown))
    is_as_clear = roof_m <= roof_m[is_own].max()
    for is_obstacle in (~is_as_clear, roof_m >= limited_map.altitude_m):
        if is_obstacle.any():  # otherwise there is nothing to keep a distance from
            away = distance_transform_edt(~maximum_filter(is_obstacle, 3))
            is_as_clear &= away >= away[is_own].min()
    return is_as_clear
