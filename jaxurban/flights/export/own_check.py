"""What is written is judged first: a mission that would meet a roof, the ground or a zone is refused."""

import math
from dataclasses import replace

import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.flights.contacts import buildings_of
from jaxurban.flights.judge import judged
from jaxurban.flights.legs import flight_of
from jaxurban.flights.missions.items import read_plan
from jaxurban.io.city import City
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.sources import left_out, standing_on
from jaxurban.paths.closed import constraints_of
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.path import PlannedPath

NO_MAPS = "It was not checked, as the path has no maps."
UNSURE = "may meet what is of unknown height as it takes off or lands"
REMEDY = (
    "let its ends be moved to free ground (--snap, snap=True) and not be left in the air (--ends-in-air, "
    "on_ground=False), plan it again with greater clearances, or save it as .kml, .gpx or .geojson"
)


def check_own(route: PlannedPath, data: bytes) -> str:
    """Return a sentence on how a mission was judged that is about to be written.

    The cells that roofs touch are looked at first, as they hold every outline. Exact outlines, from the files of the
    maps, decide where these find anything, or where the ground of the cells is not that of the terrain's file.

    Args:
      route: the path, whose own constraints count.
      data: the bytes of its ``.plan``.

    Raises:
      InputError: the mission meets an obstacle, the ground, a zone or a closed cell, or takes off or lands through what
        is of unknown height: says where, and what to do.
    """
    maps = route.maps
    if maps is None:
        return NO_MAPS
    way = f"cells of {maps.grid.resolution_m:g} m"
    city = None
    findings = _findings(route, maps, data, None)
    if len(findings) or not Elevation(maps, None).is_exact:
        standing = standing_on(maps)
        city = standing.city
        if city is not None:
            findings = _findings(route, maps, data, city)
            way = standing.outlines
    if not len(findings):
        verdict = f"Checked by {way} before it was written: it meets no obstacle, ground or zone."
        return f"{verdict} {left_out(maps, city)}".rstrip()
    first = findings.iloc[0]
    raise InputError(
        f"the mission is not written, as its own check ({way}) finds that it {first['what']}, from "
        f"{first['along_m']:z.0f} to {first['to_m']:z.0f} m along it: {REMEDY}"
    )


def _findings(route: PlannedPath, maps: MetricMaps, data: bytes, city: City | None) -> pd.DataFrame:
    """Return the findings of a mission over maps (`judged`), and where it may meet something on its way up or down.

    Without a city the maps' cells stand.
    """
    mission = read_plan(data, "the mission", None, math.nan)
    flight = flight_of(mission, Elevation(maps, city))
    known = shapely.box(*maps.grid.bounds_m)  # what lies beyond is no finding
    times, time_of_day = [route.settings.get("time")], route.settings.get("time_of_day")
    buildings = buildings_of(maps, city)
    limits = constraints_of(route)
    limits = replace(limits, zones=(*limits.zones, *mission.zones))
    findings, unknown, _ = judged(flight, buildings, known, limits, times, time_of_day)
    is_guess = unknown["kind"] == "roof"
    site_m = flight.steps.along_m[flight.is_on_site(flight.steps)]
    rows = unknown[is_guess].rename(columns={"from_m": "along_m"}).assign(what=UNSURE)
    is_met = [
        ((site_m[:, 0] < row.to_m) & (row.along_m < site_m[:, 1])).any()
        for row in rows.itertuples()
    ]
    return pd.concat([findings, rows[is_met]]) if any(is_met) else findings
