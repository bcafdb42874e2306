"""The geofence of a plan of QGroundControl, version 2: areas to stay in, and others to keep out of, at all heights.

Autopilots look at degrees and count crossings, so that a place which an outline goes around twice is outside of it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from jaxurban.io.read.outlines import polygonal
from jaxurban.io.read.zone import Zone
from jaxurban.world.grid import WGS84

CHORDS = 180  # of a quarter of a circle: they leave one of 1 km by 1 cm


def read_geofence(
    geofence: Mapping[str, Any], source: str
) -> tuple[list[Zone], list[Zone], list[str]]:
    """Return the areas of a geofence to keep out of, those to stay in, and a sentence on each that is damaged.

    Args:
      geofence: the object of JSON.
      source: name of the file.
    """
    zones: dict[bool, list[Zone]] = {False: [], True: []}  # by whether a flight must stay in it
    notes = []
    for kind, outline_of in (("polygon", _polygon), ("circle", _circle)):
        for number, part in enumerate(geofence.get(f"{kind}s") or [], 1):
            name = f"geofence {kind} {number}"
            try:
                zone = Zone(name, *outline_of(part), source=source)
                zones[part["inclusion"]].append(zone)
            except (LookupError, TypeError, ValueError):
                notes.append(f"{name} is damaged, and not judged")
    return zones[False], zones[True], notes


def _polygon(part: Any) -> tuple[shapely.Geometry, str]:
    """Return a polygon and its CRS; beyond the antimeridian its longitudes go on."""
    lats, lons = _places(part["polygon"]).T
    ring = shapely.Polygon(np.column_stack([np.unwrap(lons, period=360), lats]))
    return polygonal(shapely.make_valid(ring)), WGS84


def _circle(part: Any) -> tuple[shapely.Geometry, str]:
    """Return a circle and a CRS around its centre."""
    circle = part["circle"]
    ((lat, lon),) = _places([circle["center"]])
    area = shapely.Point(0, 0).buffer(float(circle["radius"]), CHORDS)
    return area, f"+proj=aeqd +lat_0={lat} +lon_0={lon} +datum=WGS84"


def _places(rows: Any) -> np.ndarray:
    """Return ``[N, 2]`` latitude and longitude in degrees; ValueError where they are none."""
    places = np.array(rows, float)
    if not (np.abs(places) <= (90, 180)).all():
        raise ValueError(rows)
    return places
