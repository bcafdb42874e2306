"""Missions of DJI's drones: waylines (WPML), alone or packed with their template as KMZ.

| part | how it is flown |
|---|---|
| way to the first waypoint, ``safely`` | up to its height or the security height, the greater; level; down |
| ``pointToPoint``, and ways of a Matrice 300 | not judged |
| waypoints | straight from each to the next |
| turn ``toPointAndStopWithDiscontinuityCurvature`` | a stop |
| turn ``coordinateTurn`` | the corner may be cut, as far from the waypoint as the file says |
| all other turns, ways between waylines | judged as if straight, and named |
| finish ``goHome`` | a return at the file's height |
| ``autoLand``, ``gotoFirstWaypoint``, ``noAction`` | a landing, a straight way, hovering |

What a drone does when the link is lost is not looked at, as of other autopilots. The elements:
https://developer.dji.com/doc/cloud-api-tutorial/en/api-reference/dji-wpml/waylines-wpml.html.
"""

import io
import math
import re
from itertools import pairwise
from xml.etree.ElementTree import Element
from zipfile import ZipFile

from jaxurban.flights.missions.flight import LAND, RETURN, TAKEOFF, WAYPOINT, Item
from jaxurban.flights.missions.items import home_of, mission_of
from jaxurban.flights.missions.lines import point_of, tag_of, text_of, words_of, xml_root
from jaxurban.flights.missions.parts import (
    SAME_M,
    DamagedError,
    Datum,
    LonLat,
    Mission,
    check_place,
    decimal_of,
    one_value,
)

MOST_UNPACKED = 2**26  # bytes in a KMZ, with its pictures
HEIGHT_MODES: dict[str, Datum] = {"relativeToStartPoint": "home", "WGS84": "ellipsoid"}
TURN_MODE = "waypointTurnParam", "waypointTurnMode"
TURN_CUT = "waypointTurnParam", "waypointTurnDampingDist"
STOP = "toPointAndStopWithDiscontinuityCurvature"
MATRICE_300 = "60"  # droneEnumValue
ENDS = {"goHome": RETURN, "autoLand": LAND}
STILL_ACTION = re.compile(
    "accurateShoot|customDirName|focus|gimbal.*|hover|megaphone|orientedShoot|panoShot|recordPointCloud|rotateYaw|"
    "searchlight|setFocusType|startRecord|startSmartOblique|startTimeLapse|stopRecord|stopTimeLapse|takePhoto|zoom"
)


def unzipped(data: bytes) -> tuple[str, bytes, bytes]:
    """Return the suffix and the bytes of what a KMZ holds, waylines or else KML, and of the template of waylines.

    Raises:
      DamagedError: it holds no mission or several, or more than `MOST_UNPACKED`.
      errors of `UNPACKING`, RuntimeError: it is damaged or encrypted.
    """
    with ZipFile(io.BytesIO(data)) as archive:
        if sum(file.file_size for file in archive.infolist()) > MOST_UNPACKED:
            raise DamagedError("it unpacks to more than 64 MB: name the .wpml or .kml in it")
        waylines, others = (
            [archive.read(name) for name in archive.namelist() if name.lower().endswith(suffix)]
            for suffix in (".wpml", ".kml")
        )
    if len(waylines or others) != 1:
        raise DamagedError("it must hold one .wpml or one .kml: unpack it, and name one file")
    data, template, *_ = *waylines, *others, b""
    return ".wpml" if waylines else ".kml", data, template


def read_wpml(
    data: bytes, template: bytes, name: str, home: LonLat | None, return_altitude_m: float
) -> Mission:
    """Return the mission of waylines.

    Args:
      data: the bytes of the file, XML.
      template: from which the waylines were made, XML; it may hold the point of reference for the take-off.
      name: of the file, for messages.
      home: longitude and latitude in degrees, in place of the point of reference.
      return_altitude_m: metres above home; NaN takes that of the file.

    Raises:
      InputError: it holds no waypoint.
      DamagedError: it cannot be read.
    """
    files = Element("files")
    files.extend([xml_root(text) for text in ([data, template] if template else [data])])

    def said(*names: str) -> str:
        """Return what the files say of the whole mission."""
        return text_of(files, "kml", "Document", "missionConfig", *names)

    # Waypoints in the order of the file, and what is not as it seems.
    items: list[Item] = []
    notes = []
    num_things = 0
    for element in files[0].iter():
        tag = tag_of(element)
        if tag == "Folder":
            mode = text_of(element, "executeHeightMode")
            waypoints = [child for child in element if tag_of(child) == "Placemark"]
            indices = [decimal_of("an index", text_of(each, "index")) for each in waypoints]
            rises = {after - before for before, after in pairwise(indices)}
            if rises - {1.0} and not all(map(math.isnan, indices)):
                raise DamagedError(
                    "the index of its waypoints does not rise by one: put them in order"
                )
            if items:
                notes.append("the ways between its waylines are judged as if straight")
            for waypoint in waypoints:
                items.append(_waypoint(waypoint, len(items) + 1, mode))
                if text_of(waypoint, *TURN_MODE) not in (STOP, "coordinateTurn"):
                    notes.append("curves at its waypoints are judged as if straight")
        elif tag == "Placemark":
            num_things += 1
        elif tag == "actionActuatorFunc" and not STILL_ACTION.fullmatch(words_of(element)):
            notes.append(f"the action {words_of(element)[:40]!r} is not judged")

    # What follows the last waypoint, and how the first one is reached, where the file says it.
    first = items[0]
    end = said("finishAction")
    if end != "noAction":
        last = Item(0, None, ENDS.get(end, -1), what=f"the finish action {end[:40]!r}")
        last = first if end == "gotoFirstWaypoint" else last
        items.append(last._replace(number=len(items) + 1))
        num_things += 1
    security_m = decimal_of("a height", said("takeOffSecurityHeight"))
    is_safe = said("flyToWaylineMode") == "safely" and security_m >= 0
    if first.datum and is_safe and said("droneInfo", "droneEnumValue") != MATRICE_300:
        items.insert(0, first._replace(command=TAKEOFF, params=(security_m,)))
        num_things += 1

    lat, lon, _ = point_of(said("takeOffRefPoint").split(","))
    start = home_of(home, lon, lat, math.nan)
    if math.isnan(return_altitude_m):
        return_altitude_m = decimal_of("a height", said("globalRTHHeight"))
    return mission_of(name, items, num_things, start, notes, "dji", return_altitude_m)


def _waypoint(element: Element, number: int, mode: str) -> Item:
    """Return a waypoint, whose parameters are whether it is a stop, and how far from it the corner may be cut.

    Args:
      element: its Placemark. What stands deeper in it, in a group of actions, does not count.
      number: of the item.
      mode: what its height is above, a key of `HEIGHT_MODES`; others are not read.

    Raises:
      DamagedError: a value is missing, two differ, or the place is not on the Earth.
    """
    what = f"item {number}"
    if mode not in HEIGHT_MODES:
        return Item(number, None, -1, what=f"a waypoint of the height mode {mode[:40]!r}")
    values = text_of(element, "Point", "coordinates").split(",")
    lon, lat, _ = point_of(values)
    # Programs that write a third coordinate of 0 say no height by it.
    others = [value for value in values[2:] if decimal_of("a coordinate", value) != 0]
    heights = (text_of(element, "executeHeight"), *others)
    height_m = decimal_of("an executeHeight", one_value(f"the height of {what}", heights, SAME_M))
    if math.isnan(lon + lat + height_m):
        raise DamagedError(f"{what} lacks its longitude, latitude or executeHeight")
    check_place(what, lon, lat, height_m)
    cut_m = decimal_of("a waypointTurnDampingDist", text_of(element, *TURN_CUT))
    turn = (text_of(element, *TURN_MODE) == STOP, cut_m)
    return Item(number, None, WAYPOINT, turn, lon, lat, height_m, HEIGHT_MODES[mode])
