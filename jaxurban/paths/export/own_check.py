"""What is written is judged first: a mission that would meet a roof, the ground or a zone is refused."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.mission_items import read_plan
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.sources import standing_on
from jaxurban.paths.check import constraints_of
from jaxurban.paths.contacts import buildings_of
from jaxurban.paths.elevation import Elevation
from jaxurban.paths.judge import judged
from jaxurban.paths.legs import flight_of
from jaxurban.paths.path import PlannedPath

NO_MAPS = "It was not checked, as the path has no maps."
ANOTHER_PLAN = "plan it again with greater clearances, or save it as .kml, .gpx or .geojson"
MOVE = "let the ends be moved there (--snap; snap=True, on_ground=True; the viewer's planners and rules)"
FROM_ROOF = "pass --from-roof (from_roof=True) if the flight starts from that roof"


def check_own(route: PlannedPath, data: bytes) -> str:
    """Return a sentence on how a mission was judged that is about to be written.

    The cells that roofs touch are looked at first, as they hold every outline. Where these find anything, or where the
    ground of the cells is not that of the terrain's file, exact outlines decide, from the files of the maps.

    Args:
      route: the path, whose own constraints count.
      data: the bytes of its ``.plan``.

    Raises:
      InputError: the mission meets a building, the ground, a zone or a closed cell: says where, and what to do.
    """
    maps = route.maps
    if maps is None:
        return NO_MAPS
    way = f"cells of {maps.grid.resolution_m:g} m"
    findings = _findings(route, maps, data, None)
    if len(findings) or not Elevation(maps, None).is_exact:
        city, outlines, _ = standing_on(maps)
        if city is not None:
            findings = _findings(route, maps, data, city)
            way = outlines
    if not len(findings):
        return f"Checked by {way} before it was written: it meets no building, ground or zone."
    first = findings.iloc[0]
    raise InputError(
        f"the mission is not written, as its own check ({way}) finds that it {first['what']}, from "
        f"{first['along_m']:.0f} to {first['to_m']:.0f} m along it: {_remedy(route, maps)}"
    )


def _findings(route: PlannedPath, maps: MetricMaps, data: bytes, city: City | None) -> pd.DataFrame:
    """Return the findings of a mission over maps (`judged`); without a city by the maps' cells."""
    mission = read_plan(data, "the mission", None, math.nan)
    flight = flight_of(mission, Elevation(maps, city))
    known = shapely.box(*maps.grid.bounds_m)  # what lies beyond is no finding
    times, time_of_day = [route.settings.get("time")], route.settings.get("time_of_day")
    buildings = buildings_of(maps, city)
    limits = constraints_of(route)
    limits = replace(limits, zones=(*limits.zones, *mission.zones))
    findings, _ = judged(flight, buildings, known, limits, times, time_of_day)
    return findings


def _remedy(route: PlannedPath, maps: MetricMaps) -> str:
    """Return what to do about a mission that is not written: where it may take off or land, or to plan otherwise."""
    grid = maps.grid
    for name, act, place in (("start", "take off", 0), ("goal", "land", -1)):
        xy_m = route.xy_m[place]
        is_free = constraints_of(route).is_free_to_ground(
            maps,
            float(route.z_m[place]),
            time=route.settings.get("time"),
            time_of_day=route.settings.get("time_of_day"),
        )
        if is_free[grid.cell_of_xy(*xy_m)] or not is_free.any():
            continue
        cells = np.argwhere(is_free)
        away_m = np.hypot(*np.subtract(grid.xy_of_cell(*cells.T), xy_m[:, None]))
        nearest = int(np.argmin(away_m))
        lon, lat = grid.lonlat_of_cell(*cells[nearest])
        remedies = [
            f"the nearest place to {act} is {lon:.6f},{lat:.6f}, {away_m[nearest]:.0f} m from the {name}",
            MOVE,
            *([FROM_ROOF] if name == "start" else []),
        ]
        return "; ".join(remedies)
    return ANOTHER_PLAN
