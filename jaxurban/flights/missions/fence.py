"""The geofence of a plan of QGroundControl, version 2, as no-fly zones: areas to keep out of, and all outside others.

Autopilots look at degrees and count crossings, so that a place which an outline goes around twice is outside of it. Of
several areas to stay in both ask for all at once: ArduPilot unless its ``FENCE_OPTIONS`` say otherwise, PX4 since 1.15
(``Geofence::isInsidePolygonOrCircle``: ``checksPass &=``; its pull request 22394). Before, PX4 asked for any one.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from jaxurban.flights.missions.parts import circle_around
from jaxurban.io.zone import Zone
from jaxurban.world.extent import polygonal

EARTH = shapely.box(-180, -90, 180, 90)
CHORDS = 720  # of a circle: they leave one of 1 km by 1 cm
MOST_RADIUS_M = 1e6  # around a city no such circle holds a pole, about which degrees go round


def read_geofence(geofence: Mapping[str, Any], source: str) -> tuple[list[Zone], list[str]]:
    """Return where a geofence lets nobody fly, and a sentence on each area that is damaged.

    Args:
      geofence: the object of JSON.
      source: name of the file.
    """
    zones: dict[bool, list[Zone]] = {False: [], True: []}  # by whether a flight must stay in it
    notes = []
    for kind, corners_of in (("polygon", _places), ("circle", _circle)):
        for number, part in enumerate(geofence.get(f"{kind}s") or [], 1):
            name = f"geofence {kind} {number}"
            try:
                more = ", ".join(part.keys() - {kind, "inclusion", "version"})
                if more:
                    notes.append(f"{name} holds {more}, which is not judged")
                lats, lons = corners_of(part[kind]).T
                if part.get("version", 1) != 1:
                    raise ValueError(part["version"])
                ring = shapely.Polygon(np.column_stack([np.unwrap(lons, period=360), lats]))
                area = polygonal(shapely.make_valid(ring))
                zones[part["inclusion"]].append(Zone(name, area, source=source))
            except (AttributeError, LookupError, TypeError, ValueError):
                notes.append(f"{name} is damaged, and not judged")

    for zone in zones[True]:
        outside = EARTH - zone.polygon
        if not outside.is_empty:
            zones[False].append(Zone("land outside the geofence", outside, source=source))
    return zones[False], notes


def _places(rows: Any) -> np.ndarray:
    """Return ``[N, 2]`` latitude and longitude in degrees; TypeError or ValueError where rows are none."""
    places = np.array(rows, float)
    if not (np.abs(places) <= (90, 180)).all():
        raise ValueError(rows)
    return places


def _circle(circle: Any) -> np.ndarray:
    """Return ``[N, 2]`` latitude and longitude in degrees of places on a circle; ValueError where it is too large."""
    ((lat, lon),) = _places([circle["center"]])
    radius_m = float(circle["radius"])
    if not 0 < radius_m <= MOST_RADIUS_M:
        raise ValueError(radius_m)
    return circle_around(lon, lat, radius_m, np.linspace(0, 360, CHORDS + 1))[::-1].T
