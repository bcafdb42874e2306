"""The least altitude at which a mission may return home from each of its items, and what to say of it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from jaxurban.io.read.mission_parts import Leg, Mission, Place
from jaxurban.kernels.tolerances import FILE_MARGIN_M
from jaxurban.paths.autopilots import Departure, parameter_lines, typed_m
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.contacts import TOUCH_M, Prisms, contacts
from jaxurban.paths.judge import is_off
from jaxurban.paths.legs import NOWHERE_M, Flight, elevation_of, flight_of, zeros_of

ENDING = ("land", "return")  # kinds of legs that end on the way home, or there
MOST_STEPS = 10_000  # that are looked at together, so that few pairs of them and outlines are held
NO_DATA = "the line home leaves what is known"
NO_BOUND = "the line home passes what is of a height that nothing bounds"


def item_returns(
    flight: Flight,
    buildings: Prisms,
    known: shapely.Geometry,
    limits: Constraints,
    geoid_m: float | None,
) -> pd.DataFrame:
    """Return the least altitude at which a straight, level way home clears everything, from each item of a mission.

    It clears outlines that are no farther from the line in plan than the horizontal clearance, up to the bound of what
    is of guessed height, and the ground below the line, by the vertical clearance. What hangs in the air is passed
    above. No-fly zones and closed cells do not count, nor do the climb at the item and the descent at home.

    Args:
      flight: the mission over the maps.
      buildings: what stands there.
      known: the area in which all buildings are known, in the maps' CRS.
      limits: the clearances.
      geoid_m: height of the geoid above the ellipsoid; None where it is not given.

    Returns:
      A row for each place at which an item ends, in the order flown, with the columns of `Departure`. No row without a
      home.
    """
    # The ways home, level with home: what they lack there of a clearance, the return altitude has to give.
    mission, ground = flight.mission, flight.ground
    maps = ground.maps
    ends = {(leg.item, leg.end): None for leg in mission.legs if leg.kind not in ENDING}
    if mission.home is None or not ends:
        return pd.DataFrame(columns=Departure._fields)
    home = Place(*mission.home, 0.0, "home")
    legs = tuple(Leg(home._replace(lon=at.lon, lat=at.lat), home, "leg", item) for item, at in ends)
    steps = flight_of(replace(mission, legs=legs), ground).steps
    is_known = maps.ds["has_data"].values[tuple(steps.cell.T)] & np.isfinite(steps.z_m).all(axis=1)
    steps = steps.take(is_known & ~is_off(steps, known, limits.horizontal_m))
    if not ground.is_exact:
        steps = steps._replace(z_m=steps.z_m - ground.off_m[tuple(steps.cell.T)][:, None])

    # Of the ground and what stands, and of what may stand within a bound.
    least_m, guessed_m = np.full((2, len(legs)), -np.inf)
    np.maximum.at(least_m, steps.leg, limits.vertical_m - steps.z_m.min(axis=1))
    clearance_m = max(limits.vertical_m, FILE_MARGIN_M)
    buildings = buildings._replace(floor_m=np.full(len(buildings.top_m), -np.inf))
    for part in np.array_split(np.arange(len(steps.leg)), len(steps.leg) // MOST_STEPS + 1):
        near = contacts(steps.take(part), buildings, ground, limits.horizontal_m)
        leg = steps.leg[part[near["step"]]]
        np.maximum.at(least_m, leg, clearance_m - near["gap_m"])
        np.maximum.at(guessed_m, leg, clearance_m - near["spare_m"])

    # A way that is cut off has fewer metres, or no step at all.
    lonlat = np.array([mission.home, *(at[:2] for _, at in ends)])
    places_m = np.nan_to_num(maps.grid.xy_at(lonlat), posinf=NOWHERE_M)
    apart_m = np.linalg.norm(places_m[1:] - places_m[0], axis=1)
    is_cut = np.bincount(steps.leg, steps.over_m, len(legs)) < apart_m - TOUCH_M
    needed_m = np.maximum(least_m, guessed_m)
    why = np.select([is_cut | np.isneginf(least_m), np.isposinf(needed_m)], [NO_DATA, NO_BOUND], "")
    zeros_m = zeros_of(mission, ground, geoid_m)
    return pd.DataFrame(
        {
            "item": [item for item, _ in ends],
            "apart_m": apart_m,
            "own_m": [elevation_of(at, ground, zeros_m) - zeros_m["home"] for _, at in ends],
            "least_m": np.where(why == "", needed_m, np.nan),
            "as_guessed_m": np.where(why == NO_DATA, np.nan, least_m),
            "why": why,
        }
    )


def return_lines(table: pd.DataFrame, mission: Mission) -> list[str]:
    """Return what to say of the altitudes at which a mission may return: of its own, the least, and what to type.

    Args:
      table: the least altitudes (`item_returns`).
      mission: whose autopilot and return altitude count.
    """
    departures = [Departure(*row) for row in table.itertuples(index=False)]
    unknown = [each for each in departures if each.why]
    low = [each for each in departures if each.is_low(mission.autopilot, 0.0)]
    lines = []
    if low:
        altitude_m = mission.return_altitude_m
        failing = [each for each in low if each.is_low(mission.autopilot, altitude_m)]
        fails = f"{altitude_m:g} m fails from item {failing[0].item} on; " if failing else ""
        worst = max(low, key=lambda each: each.least_m)
        as_guessed_m = typed_m(max(each.as_guessed_m for each in low))
        guess = f" ({as_guessed_m} m if guessed heights are right)"
        if as_guessed_m == typed_m(worst.least_m):
            guess = ""
        lines.append(f"A return at {fails}{typed_m(worst.least_m)} m clears all items{guess}.")
        lines += parameter_lines(worst.least_m, mission.autopilot, departures)
    elif len(unknown) < len(departures):
        lines.append("A return from each item clears all at the height of the item.")
    lines += [
        f"No return altitude is known from item {each.item} on: {each.why}." for each in unknown[:1]
    ]
    return lines
