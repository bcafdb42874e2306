"""Missions of DJI's drones: waylines (WPML), alone or packed with their template as KMZ.

| part | how it is flown |
|---|---|
| way to the first waypoint, ``safely`` | up to the security height, or to that of a higher waypoint; level; down |
| ``pointToPoint`` | up to the security height, and straight on to a waypoint that is higher |
| waypoints | straight from each to the next |
| turn ``toPointAndStopWithDiscontinuityCurvature`` | a stop |
| turn ``coordinateTurn`` | the corner may be cut, as far from the waypoint as the file says |
| all other turns, ways between waylines | judged as if straight, and named |
| finish ``goHome`` | a return at the file's height |
| ``autoLand``, ``gotoFirstWaypoint``, ``noAction`` | a landing, a straight way, hovering |

A Matrice 300 knows no security height. What a drone does when the link is lost is not looked at, as of other
autopilots. The elements:
https://developer.dji.com/doc/cloud-api-tutorial/en/api-reference/dji-wpml/waylines-wpml.html.
"""

import io
import math
import re
from xml.etree.ElementTree import Element
from zipfile import ZipFile

from jaxurban.io.read.mission_flight import APPROACH, LAND, RETURN, WAYPOINT, FlownItems, Item
from jaxurban.io.read.mission_items import home_of, mission_of
from jaxurban.io.read.mission_lines import point_of, tag_of, text_of, words_of, xml_root
from jaxurban.io.read.mission_parts import (
    DamagedError,
    Datum,
    LonLat,
    Mission,
    check_place,
    decimal_of,
)

MOST_UNPACKED = 2**26  # bytes in a KMZ, with its pictures
HEIGHT_MODES: dict[str, Datum] = {"relativeToStartPoint": "home", "WGS84": "ellipsoid"}
FLY_TO = SAFELY, SLANTED = "safely", "pointToPoint"
TO_FIRST = "gotoFirstWaypoint"
ENDS = {"goHome": RETURN, "autoLand": LAND, TO_FIRST: WAYPOINT}
SECURITY = "takeOffSecurityHeight"
MATRICE_300 = "60"  # droneEnumValue
STILL_ACTION = re.compile(
    "accurateShoot|customDirName|focus|gimbal.*|hover|megaphone|orientedShoot|panoShot|recordPointCloud|rotateYaw|"
    "searchlight|setFocusType|startRecord|startSmartOblique|startTimeLapse|stopRecord|stopTimeLapse|takePhoto|zoom"
)


def unzipped(data: bytes) -> tuple[str, bytes, bytes]:
    """Return the suffix and the bytes of what a KMZ holds, waylines or else KML, and of the template of waylines.

    Raises:
      DamagedError: it holds no mission or several, or more than `MOST_UNPACKED`.
      BadZipFile, RuntimeError, zlib.error, EOFError: it is damaged or encrypted.
    """
    with ZipFile(io.BytesIO(data)) as archive:
        files = archive.infolist()
        waylines = [file for file in files if file.filename.endswith(".wpml")]
        others = [file for file in files if file.filename.endswith(".kml")]
        if len(waylines or others) != 1:
            raise DamagedError("it must hold one .wpml or one .kml: unpack it, and name one file")
        if sum(file.file_size for file in files) > MOST_UNPACKED:
            raise DamagedError(
                "it unpacks to more than 64 MB: name the .wpml or .kml that is in it"
            )
        first, *more = map(archive.read, waylines + others)
    return ".wpml" if waylines else ".kml", first, b"".join(more)


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
    root = xml_root(data)
    words = _words(xml_root(template or data)) | _words(root)
    elements = [*root.iter()]

    # Waypoints, in the order of the file, and what is not as it seems of them.
    items: list[Item] = []
    num_waylines = 0
    mode = ""
    for element in elements:
        if tag_of(element) == "Folder":
            num_waylines += 1
            mode = text_of(element, "executeHeightMode")
        elif tag_of(element) == "Placemark":
            items.append(_waypoint(element, len(items) + 1, mode))
    num_things = sum(tag_of(element) == "Point" for element in elements)
    notes = []
    if num_waylines > 1:
        notes.append(f"the ways between its {num_waylines} waylines are judged as if straight")
    curved = [str(item.number) for item in items if item.params and math.isnan(item.params[1])]
    if curved:
        notes.append(f"the curves at items {', '.join(curved)} are judged as if straight")
    actions = [words_of(each) for each in elements if tag_of(each) == "actionActuatorFunc"]
    strange = [action for action in actions if not STILL_ACTION.fullmatch(action)]
    notes += [f"the action {action[:40]!r} is not judged" for action in strange]

    # What follows the last waypoint, and how the first one is reached where the file says it.
    end = words.get("finishAction", "")
    if items and end != "noAction":
        what = f"the finish action {end[:40]!r}"
        last = items[0] if end == TO_FIRST else Item(0, None, ENDS.get(end, -1), what=what)
        items.append(last._replace(number=len(items) + 1))
        num_things += 1
    fly_to = words.get("flyToWaylineMode")
    is_old = words.get("droneEnumValue") == MATRICE_300
    security_m = 0.0 if is_old else decimal_of(SECURITY, words.get(SECURITY))
    if items and items[0].datum and fly_to in FLY_TO and security_m >= 0:
        params = (security_m, fly_to == SLANTED)
        items[0] = items[0]._replace(command=APPROACH, params=params)
    lat, lon, _ = point_of(words.get("takeOffRefPoint", "").split(","))
    start = home_of(home, lon, lat, math.nan)
    if math.isnan(return_altitude_m):
        return_altitude_m = decimal_of("globalRTHHeight", words.get("globalRTHHeight"))
    speed_m_s = decimal_of("autoFlightSpeed", words.get("autoFlightSpeed"))
    flown = FlownItems(items, start[0], return_altitude_m, "dji")
    return mission_of(name, flown, num_things, start, notes, speed_m_s)


def _words(root: Element) -> dict[str, str]:
    """Return the text within each element by its name, of several the last one."""
    return {tag_of(element): words_of(element) for element in root.iter()}


def _waypoint(placemark: Element, number: int, mode: str) -> Item:
    """Return a waypoint, whose parameters are whether it is a stop, and where its corner is cut: NaN for other curves.

    Args:
      placemark: the element.
      number: of the item.
      mode: what its height is above, a key of `HEIGHT_MODES`; others are not read.

    Raises:
      DamagedError: a value is missing, or the place is not on the Earth.
    """
    what = f"item {number}"
    if mode not in HEIGHT_MODES:
        return Item(number, None, -1, what=f"a waypoint of the height mode {mode[:40]!r}")
    words = _words(placemark)
    lon, lat, _ = point_of(words.get("coordinates", "").split(","))
    height_m = decimal_of(f"the height of {what}", words.get("executeHeight"))
    if math.isnan(lon + lat + height_m):
        raise DamagedError(f"{what} lacks its longitude, latitude or executeHeight")
    check_place(what, lon, lat, height_m)
    turn = words.get("waypointTurnMode")
    is_stop = turn == "toPointAndStopWithDiscontinuityCurvature"
    cut_m = 0.0 if is_stop else math.nan
    if turn == "coordinateTurn":
        cut_m = decimal_of("a waypointTurnDampingDist", words.get("waypointTurnDampingDist"))
    return Item(number, None, WAYPOINT, (is_stop, cut_m), lon, lat, height_m, HEIGHT_MODES[mode])
