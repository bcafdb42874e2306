"""Planned paths as files for other programs: GeoJSON, KML, QGroundControl plan."""

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np
import shapely

from jaxurban.errors import InputError
from jaxurban.ground import Ground
from jaxurban.io.store import whole_file
from jaxurban.planners.base import Status

DECIMALS = 7  # of a degree: about a centimetre
Z_DECIMALS = 2  # of a metre
STRAIGHT_M = 0.01  # a waypoint closer than this to the line through its neighbours is left out of a .plan
GROUND_TOLERANCE_M = 1.0  # by which the straight lines of a .plan may miss the planned height above ground
HEIGHT_REFERENCE = "altitude_m and z_m are metres above the ground below each point, not above sea level"
GROUND_REFERENCE = "ground_m is in metres above the zero of the terrain file, whatever its vertical datum is"

# MAVLink common message set, and the values that QGroundControl's plan format takes from it
MAV_CMD_NAV_WAYPOINT, MAV_CMD_NAV_TAKEOFF = 16, 22
MAV_FRAME_GLOBAL_RELATIVE_ALT = 3
MAV_AUTOPILOT_PX4, MAV_TYPE_QUADROTOR = 12, 2
ALTITUDE_RELATIVE = 1


class Route(Protocol):
    """What is written: a `PlannedPath`. ``N`` points."""

    @property
    def status(self) -> Status:
        """How the planner ended."""

    @property
    def xy_m(self) -> np.ndarray:
        """``[N, 2]`` easting, northing in a projected CRS."""

    @property
    def lonlat(self) -> np.ndarray:
        """``[N, 2]`` longitude, latitude in degrees."""

    @property
    def z_m(self) -> np.ndarray:
        """``[N]`` altitude above ground of each point."""

    @property
    def altitude_m(self) -> float:
        """Altitude above ground at the start."""

    @property
    def ground(self) -> Ground | None:
        """The ground under it; None where it is not known."""

    def to_dict(self) -> dict[str, Any]:
        """Everything but the points, JSON-ready."""


class Report(Protocol):
    """What is known of the route beside: a `RouteReport`."""

    @property
    def lines(self) -> Sequence[np.ndarray]:
        """Longitude, latitude ``[K, 2]`` of each segment."""

    def to_dict(self) -> dict[str, Any]:
        """Its facts, JSON-ready; ``"segments"`` holds those of each line."""


Encode = Callable[[Route, Report | None], bytes]


def write_path(route: Route, file: str | Path, report: Report | None = None) -> bool:
    """Write a path in the format that the file's suffix names; return False, writing nothing, if there is no path.

    ``.geojson`` (RFC 7946): a FeatureCollection of one LineString. Coordinates are longitude and latitude
    only, since a third one would be a height above the ellipsoid; the altitudes above ground and all else
    that is known of the path are properties (``altitude_m``, ``z_m`` of each point, ``cost``, ``metrics`` ...;
    ``height_reference`` says what the heights count from; over terrain, ``ground_m`` is the elevation below each).
    With a report its facts are properties too, and each of its segments is a LineString more (``segment``: 1, 2 ...).
    ``.kml``: a LineString at its altitude above ground (``relativeToGround``), the same facts as data.
    ``.plan`` (QGroundControl): take-off at the first point, then a waypoint at every turn; points within
    a centimetre of the straight line between their neighbours are left out, so that a grid path is not a
    mission of thousands. Altitudes are relative to the home position, the first point. Over maps with terrain
    they follow the ground: points are added until the straight lines between waypoints miss the planned height
    above ground by at most `GROUND_TOLERANCE_M`, and home has the terrain file's elevation. Without terrain
    level ground is assumed, and home is at 0 m; `height_note` says which, and the file holds it as ``note``.
    There is no landing: a pilot adds it. The file appears whole or not at all; an older one is replaced.

    Args:
      route: from `plan`.
      file: where to; several formats are several calls.
      report: from `jaxurban.explain`; its speed becomes the cruise speed of a ``.plan``.

    Raises:
      InputError: another suffix, or a folder that does not exist or cannot be written to.
    """
    file = Path(file)
    encode = _encoder(file)
    if not route.status.has_path:
        return False
    content = encode(route, report)
    try:
        with whole_file(file) as scratch:
            scratch.write_bytes(content)
    except OSError as error:
        raise InputError(f"cannot write {str(file)!r}: {error.strerror or error}") from error
    return True


def check_export(file: str | Path) -> None:
    """Raise InputError unless `write_path` can write this file: call it before a long search."""
    _encoder(Path(file))


def _encoder(file: Path) -> Encode:
    encode = ENCODERS.get(file.suffix.lower())
    if encode is None:
        raise InputError(f"cannot tell the format of {str(file)!r}: end its name in one of {', '.join(ENCODERS)}")
    if not file.parent.is_dir():
        raise InputError(f"the folder of {str(file)!r} does not exist: make it first, or name another file")
    if file.is_dir():
        raise InputError(f"{str(file)!r} is a folder: name a file")
    return encode


def _positions(points: np.ndarray) -> list[list[float]]:
    """Return rounded coordinates; a lone point twice, since a line needs two positions."""
    listed = np.round(points, DECIMALS).tolist()
    return listed * 2 if len(listed) == 1 else listed


def _facts(route: Route, report: Report | None) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what is known of the whole path, and of each segment."""
    told = {} if report is None else report.to_dict()
    segments = told.pop("segments", [])
    return told | route.to_dict() | {"height_reference": HEIGHT_REFERENCE}, segments


def _feature(properties: Mapping[str, Any], lonlat: np.ndarray) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": _positions(lonlat)}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _geojson(route: Route, report: Report | None) -> bytes:
    facts, segments = _facts(route, report)
    heights: dict[str, Any] = {"z_m": np.round(route.z_m, Z_DECIMALS).tolist()}
    if route.ground is not None:
        elevation_m = np.interp(np.arange(len(route.z_m)), route.ground.at, route.ground.elevation_m)
        heights |= {"ground_m": np.round(elevation_m, Z_DECIMALS).tolist(), "ground_reference": GROUND_REFERENCE}
    features = [_feature(facts | heights, route.lonlat)]
    if report is not None:
        features += [_feature(segment, line) for segment, line in zip(segments, report.lines, strict=True)]
    collection = {"type": "FeatureCollection", "features": features}
    return (json.dumps(collection, allow_nan=False) + "\n").encode()


def _kml(route: Route, report: Report | None) -> bytes:
    facts, _ = _facts(route, report)
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    placemark = ElementTree.SubElement(ElementTree.SubElement(root, "Document"), "Placemark")
    ElementTree.SubElement(placemark, "name").text = f"{facts['planner']}, {route.altitude_m:g} m above ground"
    ElementTree.SubElement(placemark, "description").text = facts["message"]
    data = ElementTree.SubElement(placemark, "ExtendedData")
    for name, value in _flat(facts):
        ElementTree.SubElement(ElementTree.SubElement(data, "Data", name=name), "value").text = str(value)
    line = ElementTree.SubElement(placemark, "LineString")
    ElementTree.SubElement(line, "altitudeMode").text = "relativeToGround"
    ElementTree.SubElement(line, "coordinates").text = " ".join(
        f"{lon:.{DECIMALS}f},{lat:.{DECIMALS}f},{z_m:.{Z_DECIMALS}f}"
        for lon, lat, z_m in _positions(np.column_stack([route.lonlat, route.z_m]))
    )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _flat(facts: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return nested facts as dotted names with plain values, those without a value left out."""
    pairs: list[tuple[str, Any]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{name}.")
        elif value is not None:
            pairs.append((prefix + name, value))
    return pairs


def _turns(xy_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """Return the indices of the points that bend the path, in plan or in profile, first and last included, ``[W]``."""
    if len(xy_m) < 3:
        return np.arange(len(xy_m))
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy_m, axis=0).T)))
    bends = [
        # The index rides along as z, which simplifying ignores.
        shapely.LineString(np.column_stack([drawn, np.arange(len(drawn))])).simplify(STRAIGHT_M)
        for drawn in (xy_m, np.column_stack([along_m, z_m]))
    ]
    return np.unique(np.concatenate([shapely.get_coordinates(line, include_z=True)[:, 2] for line in bends])).astype(
        int
    )


def _with_bends(kept: np.ndarray, along_m: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Return the indices to keep and more, so that straight lines miss no height by more than the tolerance, ``[W]``.

    Args:
      kept: indices that stay, first and last included.
      along_m: ``[G]`` length flown.
      height_m: ``[G]`` height to keep to.
    """
    bends, spans = set(kept.tolist()), list(pairwise(kept.tolist()))
    while spans:
        first, last = spans.pop()
        inner = np.arange(first + 1, last)
        line_m = np.interp(along_m[inner], along_m[[first, last]], height_m[[first, last]])
        missed_m = np.abs(height_m[inner] - line_m)
        if missed_m.max(initial=0.0) > GROUND_TOLERANCE_M:
            worst = int(inner[np.argmax(missed_m)])
            bends.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.array(sorted(bends))


def _waypoints(route: Route) -> np.ndarray:
    """Return ``[W, 3]`` longitude, latitude and height above the first point's ground of a mission's waypoints."""
    if route.ground is None:
        return np.column_stack([route.lonlat, route.z_m])[_turns(route.xy_m, route.z_m)]
    ground, number = route.ground, np.arange(len(route.z_m))
    xyz_m = np.column_stack([np.interp(ground.at, number, values) for values in (*route.xy_m.T, route.z_m)])
    along_m = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)))
    height_m = xyz_m[:, 2] + ground.elevation_m - ground.elevation_m[0]
    kept = _with_bends(_turns(xyz_m[:, :2], xyz_m[:, 2]), along_m, height_m)
    return np.column_stack([ground.lonlat, height_m])[kept]


def height_note(route: Route) -> str:
    """Return what the altitudes of a ``.plan`` take the ground for, in a sentence or two."""
    if route.ground is None:
        return (
            "These maps hold no terrain, so level ground is assumed: altitudes are relative to home, and equal heights "
            "above ground only where the ground is as high as there. Home's elevation is not known and written as 0."
        )
    return (
        f"Altitudes are relative to home and follow the ground: straight lines between waypoints keep the planned "
        f"height above it within {GROUND_TOLERANCE_M:g} m. Home is at {route.ground.elevation_m[0]:.1f} m above the "
        "zero of the terrain file, whose vertical datum need not be mean sea level."
    )


def _qgc_plan(route: Route, report: Report | None) -> bytes:
    facts, _ = _facts(route, report)
    speed_m_s = facts.get("speed_m_s")
    home_m = 0.0 if route.ground is None else float(route.ground.elevation_m[0])
    corners = np.round(_waypoints(route), DECIMALS).tolist()
    commands = [MAV_CMD_NAV_TAKEOFF] + [MAV_CMD_NAV_WAYPOINT] * (len(corners) - 1)
    items = [
        {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": command,
            "doJumpId": number,
            "frame": MAV_FRAME_GLOBAL_RELATIVE_ALT,
            "Altitude": z_m,
            "AltitudeMode": ALTITUDE_RELATIVE,
            "AMSLAltAboveTerrain": None,
            "params": [0, 0, 0, None, lat, lon, z_m],  # the fourth: yaw as the autopilot sees fit
        }
        for number, (command, (lon, lat, z_m)) in enumerate(zip(commands, corners, strict=True), start=1)
    ]
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "note": f"{height_note(route)} {facts['message']}".strip(),  # no key of the format: readers leave it alone
        "mission": {
            "version": 2,
            "firmwareType": MAV_AUTOPILOT_PX4,
            "vehicleType": MAV_TYPE_QUADROTOR,
            "globalPlanAltitudeMode": ALTITUDE_RELATIVE,
            "cruiseSpeed": speed_m_s or 15,  # m/s; else QGroundControl's defaults
            "hoverSpeed": speed_m_s or 5,
            "plannedHomePosition": [corners[0][1], corners[0][0], round(home_m, Z_DECIMALS)],
            "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    return (json.dumps(plan, indent=2, allow_nan=False) + "\n").encode()


ENCODERS: dict[str, Encode] = {".geojson": _geojson, ".kml": _kml, ".plan": _qgc_plan}
