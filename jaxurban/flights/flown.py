"""A mission in numbers: its length, metres without a fix, people overflown and clearances."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxurban.flights.legs import Flight
from jaxurban.kernels.tolerances import AT_LIMIT
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import FIX
from jaxurban.paths.profile import clearances_on, people_below, values_on
from jaxurban.paths.route_report import CLEARANCE, OVER_ROOF
from jaxurban.paths.steps import Steps

WINDOW_M = 1000.0  # of the densest stretch
FEW = 16  # of so many steps one is in a first look
SWATH_M = 10.0  # width of the strip in which people are counted


def figures_of(
    flight: Flight,
    maps: MetricMaps,
    times: Sequence[str | None],
    time_of_day: str | None,
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
        people = people_below(np.nan_to_num(density), steps, SWATH_M)
        unknown_m = float(length_m[np.isnan(density)].sum()) + off_m
        figures |= {"people_overflown": float(people.sum()), "people_unknown_m": unknown_m}
        if np.isfinite(density).any():
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
