"""A mission in numbers: metres without a fix, people overflown, exposure and cost, and the cheapest route instead."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.metrics.weights import GivenWeights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.legs import Flight, Pieces
from jaxurban.paths.path import measured
from jaxurban.paths.plan import cost_map
from jaxurban.paths.profile import nearest_level_m
from jaxurban.paths.search import PathSearch
from jaxurban.paths.snapping import XY

WINDOW_M = 1000.0  # of the densest stretch


def values_on(
    maps: MetricMaps, name: str, pieces: Pieces, time: str | None, time_of_day: str | None
) -> np.ndarray:
    """Return ``[P]`` a map's values along pieces, each at the nearest altitude; over a wall of that, the next one up.

    NaN beyond the altitudes of the maps, and where there is no value.
    """
    when: dict[str, Any] = {"time": time, "time_of_day": time_of_day}
    row, col, z_m = pieces.row, pieces.col, pieces.middle_z_m
    if "altitude" not in maps.ds[maps.variable(name)].dims:
        return maps.m(name, **when)[row, col].astype(float)
    levels_m = sorted(maps.altitudes_m)
    nearest_m, values = nearest_level_m(z_m, levels_m), np.full(len(z_m), np.nan)
    for level_m in levels_m:
        at = (
            (nearest_m <= level_m) & np.isnan(values) & (z_m >= levels_m[0]) & (z_m <= levels_m[-1])
        )
        at &= (nearest_m == level_m) | (
            np.searchsorted(levels_m, level_m) == np.searchsorted(levels_m, nearest_m) + 1
        )
        values[at] = maps.m(name, level_m, **when)[row[at], col[at]]
    return values


def figures_of(
    flight: Flight,
    maps: MetricMaps,
    times: Sequence[str | None],
    time_of_day: str | None,
    swath_m: float,
) -> dict[str, Any]:
    """Return metres without a fix, by time, and people below; metres where either is not known stand beside them."""
    levels_m = sorted(maps.altitudes_m)
    middles_m = [(low + high) / 2 for low, high in pairwise(levels_m)]
    pieces = flight.pieces.cut_at([*levels_m, *middles_m])
    length_m = pieces.length_m
    figures: dict[str, Any] = {"length_m": flight.length_m, "on_maps_m": float(length_m.sum())}
    off_m = round(flight.length_m - figures["on_maps_m"], 3)
    if FIX in maps.ds:
        by_time, unknown = {}, []
        for time in times:
            hdop = values_on(maps, FIX, pieces, time, time_of_day)
            by_time[time or maps.times[0]] = float(length_m[np.isinf(hdop)].sum())
            unknown.append(float(length_m[np.isnan(hdop)].sum()))
        figures |= {"no_fix_m": max(by_time.values()), "no_fix_by_time_m": by_time}
        figures["fix_unknown_m"] = max(unknown) + off_m
    if "density" in maps.ds:
        density = values_on(maps, "density", pieces, None, time_of_day)
        people = np.nan_to_num(density) * pieces.over_m * swath_m / M2_PER_KM2
        is_unknown = np.isnan(density)
        figures |= {"people_overflown": float(people.sum()), "swath_m": swath_m}
        figures |= densest_of(people, pieces)
        figures["people_unknown_m"] = float(length_m[is_unknown].sum()) + off_m
    return figures


def densest_of(people: np.ndarray, pieces: Pieces) -> dict[str, float]:
    """Return the most people below a kilometre of a mission, by its length on the ground, and where along it begins."""
    over_m = np.append(0.0, np.cumsum(pieces.over_m))
    total = np.append(0.0, np.cumsum(people))
    # A sum that runs straight between places is most where the window begins or ends at one of them.
    begins_m = np.concatenate([over_m, np.maximum(over_m - WINDOW_M, 0.0)])
    inside = np.interp(begins_m + WINDOW_M, over_m, total) - np.interp(begins_m, over_m, total)
    begin_m = float(begins_m[int(np.argmax(inside))])
    along_m = np.append(pieces.along_m[:, 0], pieces.along_m[-1:, 1])
    from_m = float(np.interp(begin_m, over_m, along_m)) if len(along_m) else 0.0
    return {"densest_km_people": float(inside.max()), "densest_km_from_m": from_m}


def costs_of(
    flight: Flight,
    maps: MetricMaps,
    weights: GivenWeights,
    constraints: Constraints,
    time: str | None,
    time_of_day: str | None,
) -> dict[str, Any]:
    """Return what a mission costs, by layer too, and what the cheapest route between its ends would cost.

    ``cost_note`` says why one of them is not there. Both are costed at the mission's median height, within the maps'
    altitudes; climbs and landings are left out.
    """
    legs, pieces, grid = flight.mission.legs, flight.pieces, maps.grid
    is_over = pieces.over_m > 0
    if not is_over.any():
        return {"cost_note": "No leg leads over the maps, so there is no cost."}
    order = np.argsort(pieces.z_m[is_over].mean(axis=1))
    weight_m = np.cumsum(pieces.over_m[is_over][order])
    median_m = pieces.z_m[is_over].mean(axis=1)[order][np.searchsorted(weight_m, weight_m[-1] / 2)]
    at_m = float(np.clip(np.round(median_m, 2), min(maps.altitudes_m), max(maps.altitudes_m)))
    numbers = np.array([k for k, leg in enumerate(legs) if leg.start[:2] != leg.end[:2]])
    ends = flight.lonlat[np.isin(flight.leg, numbers)]
    xy_m = np.stack(grid.xy_of_lonlat(*ends.reshape(-1, 2).T), axis=-1)
    points_m = xy_m - [grid.x_min_m, grid.y_min_m]
    figures: dict[str, Any] = {"compared_at_m": at_m}
    side_m = np.array(grid.shape[::-1]) * grid.resolution_m
    if not ((points_m >= 0) & (points_m <= side_m)).all():
        return figures | {"cost_note": "The mission leaves the maps, so it has no cost."}
    on = cost_map(
        maps, at_m, weights=weights, time=time, time_of_day=time_of_day, constraints=constraints
    )
    open_on = replace(
        on, is_free=np.ones_like(on.is_free), constraints=Constraints((), (), 0.0, 0.0)
    )
    of_flown = measured(open_on, points_m)
    figures |= {name: of_flown[name] for name in ("cost", "cost_by_layer", "exposure_by_layer")}
    try:
        cheapest = on.planned(XY(*xy_m[0]), XY(*xy_m[-1]), PathSearch.of(maps, snap=True))
    except InputError as error:
        return figures | {"cost_note": f"No route to compare with: {error}."}
    if not cheapest.status.has_path or not cheapest.length_m > 0:
        reason = (
            "the mission ends where it starts" if cheapest.status.has_path else cheapest.message
        )
        return figures | {"cost_note": f"No route to compare with: {reason}."}
    saved = of_flown["cost"] - cheapest.cost
    figures |= {"cheapest_cost": cheapest.cost, "cheapest_length_m": cheapest.length_m}
    return figures | {"saved_cost": saved, "saved_share": saved / of_flown["cost"]}
