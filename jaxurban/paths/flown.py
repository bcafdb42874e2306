"""A mission in numbers: metres without a fix, people overflown, exposure and cost, and the cheapest route instead."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.metrics.weights import WeightsLike
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.export.base import GROUND_TOLERANCE_M
from jaxurban.paths.legs import Flight, Steps
from jaxurban.paths.path import measured
from jaxurban.paths.plan import cost_map
from jaxurban.paths.profile import nearest_level_m
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import XY

WINDOW_M = 1000.0  # of the densest stretch


def values_on(
    maps: MetricMaps, name: str, steps: Steps, time: str | None, time_of_day: str | None
) -> np.ndarray:
    """Return ``[P]`` a map's values along steps, each at the nearest altitude.

    NaN without a value, and more than `GROUND_TOLERANCE_M` beyond the altitudes.
    """
    read = partial(maps.m, name, time=time, time_of_day=time_of_day)
    cell = tuple(steps.cell.T)
    z_m = steps.z_m.mean(axis=1)
    levels_m = maps.altitudes_m
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return read()[cell].astype(float)
    nearest_m = nearest_level_m(z_m, levels_m)
    is_near = np.abs(z_m - z_m.clip(min(levels_m), max(levels_m))) <= GROUND_TOLERANCE_M
    values = np.full(len(z_m), np.nan)
    for level_m in levels_m:
        is_at = (nearest_m == level_m) & is_near
        values[is_at] = read(level_m)[cell][is_at]
    return values


def figures_of(
    flight: Flight,
    maps: MetricMaps,
    times: Sequence[str | None],
    time_of_day: str | None,
    swath_m: float,
) -> dict[str, Any]:
    """Return metres without a fix, by time, and people below; metres where either is not known stand beside them."""
    steps = flight.steps
    length_m = steps.length_m
    off_m = max(0.0, round(flight.length_m - float(length_m.sum()), 3))
    figures: dict[str, Any] = {"length_m": flight.length_m, "on_maps_m": float(length_m.sum())}
    if FIX in maps.ds:
        hdop = {
            time or maps.times[0]: values_on(maps, FIX, steps, time, time_of_day) for time in times
        }
        lost_m = {time: float(length_m[np.isinf(values)].sum()) for time, values in hdop.items()}
        unknown_m = max(float(length_m[np.isnan(values)].sum()) for values in hdop.values())
        figures |= {"no_fix_m": max(lost_m.values()), "fix_unknown_m": unknown_m + off_m}
        figures["no_fix_by_time_m"] = lost_m
    if "density" in maps.ds:
        density = values_on(maps, "density", steps, None, time_of_day)
        people = np.nan_to_num(density) * steps.over_m * swath_m / M2_PER_KM2
        unknown_m = float(length_m[np.isnan(density)].sum()) + off_m
        figures |= {"people_overflown": float(people.sum()), "people_unknown_m": unknown_m}
        figures |= densest_of(people, steps)
    return figures


def densest_of(people: np.ndarray, steps: Steps) -> dict[str, float]:
    """Return the most people below a kilometre of a mission, by its length on the ground, and where along it begins."""
    over_m = np.append(0.0, np.cumsum(steps.over_m))
    total = np.append(0.0, np.cumsum(people))
    inside = np.interp(over_m + WINDOW_M, over_m, total) - total
    begin = int(np.argmax(inside))
    along_m = np.append(steps.along_m[:, 0], 0.0)
    return {"densest_km_people": float(inside[begin]), "densest_km_from_m": float(along_m[begin])}


def costs_of(
    flight: Flight,
    maps: MetricMaps,
    weights: WeightsLike,
    constraints: Constraints,
    time: str | None,
    time_of_day: str | None,
) -> dict[str, Any]:
    """Return what a mission costs, by layer too, and what the cheapest route between its ends would cost.

    ``cost_note`` says why one of them is not there. Both are costed at the mission's median height, within the maps'
    altitudes; climbs and landings are left out.
    """
    grid = maps.grid
    is_over = flight.steps.over_m > 0
    if not is_over.any():
        return {"cost_note": "No leg leads over the maps, so there is no cost."}
    median_m = np.nanmedian(flight.steps.z_m[is_over]).round(2)
    at_m = float(np.clip(median_m, min(maps.altitudes_m), max(maps.altitudes_m)))
    ends = [place[:2] for leg in flight.mission.legs for place in (leg.start, leg.end)]
    xy_m = np.stack(grid.xy_of_lonlat(*np.transpose(ends)), axis=-1)
    points_m = xy_m - grid.bounds_m[:2]
    figures: dict[str, Any] = {"compared_at_m": at_m}
    side_m = np.array(grid.shape[::-1]) * grid.resolution_m
    if not ((points_m >= 0) & (points_m <= side_m)).all():
        return figures | {"cost_note": "The mission leaves the maps, so it has no cost."}
    flown_on = cost_map(
        maps, at_m, weights=weights, time=time, time_of_day=time_of_day, constraints=constraints
    )
    open_on = replace(
        flown_on, is_free=np.ones_like(flown_on.is_free), constraints=Constraints((), (), 0.0, 0.0)
    )
    of_flown = measured(open_on, points_m)
    figures |= {name: of_flown[name] for name in ("cost", "cost_by_layer", "exposure_by_layer")}
    try:
        cheapest = flown_on.planned(XY(*xy_m[0]), XY(*xy_m[-1]), PathSearch.of(maps, snap=True))
    except InputError as error:
        return figures | {"cost_note": f"No route to compare with: {str(error).partition(';')[0]}."}
    if not cheapest.length_m > 0 or not cheapest.status.has_path:
        reason = cheapest.message
        if cheapest.status.has_path:
            reason = "the mission ends where it starts"
        return figures | {"cost_note": f"No route to compare with: {reason}."}
    saved = of_flown["cost"] - cheapest.cost
    figures |= {"cheapest_cost": cheapest.cost, "cheapest_length_m": cheapest.length_m}
    return figures | {"saved_cost": saved, "saved_share": saved / of_flown["cost"]}
