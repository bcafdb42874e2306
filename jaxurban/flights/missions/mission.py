"""Missions that other tools made, as legs whose heights name what they are above; a file is what its content says.

| file | what is read | heights are above |
|---|---|---|
| ``.plan`` of QGroundControl, version 1 | items, surveys'; home | frame 0, 5: geoid; 3, 6: home; 10, 11: ground |
| ``.waypoints``: ``QGC WPL 110`` | rows; row 0 is home where it is a waypoint | as in a ``.plan`` |
| ``.mavlink``, Parrot's ``QGC WPL 120`` | the same; row 0 is home where it is above the sea | as in a ``.plan`` |
| ``.kml`` | LineString, Track | relativeToGround: ground; absolute: geoid (EGM96); else they are asked for |
| ``.gpx`` | routes, tracks | asked for; in jaxurban's own geoid (``ele``), or ground where it has none |
| ``.geojson``, ``.json`` | LineString, MultiLineString | asked for; ground in jaxurban's own |
| ``.csv`` | rows of lon, lat, altitude_m (or height_m, alt) | asked for; AirData: home; Litchi: its modes |
| ``.kmz``, ``.wpml`` | waylines of DJI, or a KML | relativeToStartPoint: home; WGS84: ellipsoid |
| ``.ulg`` of PX4 | fixes of the receiver | geoid |

A file that names no autopilot, as no ``.waypoints`` does, is read as ArduPilot and as PX4 fly it (`Mission.other`).
The geofence of a ``.plan`` is read too, as zones. Whatever else has a position is counted and not judged. Places are in
WGS 84; a file that names another CRS or datum is refused, and so is one that gives a quantity twice with different
values (`one_value`).

| command of MAVLink | how it is flown |
|---|---|
| take-off 22, 24, 84 | straight up from home, or from the last landing; on to its own place (not by ArduPilot) |
| waypoint 16 | straight to it; latitude and longitude 0 or NaN: where the vehicle is; height NaN: that which it has |
| loiter 17, 18, 19, 31 | straight to it, then a circle of its radius; hovering where it has none |
| land 21, 85 | level to its place, then down to the ground |
| return 20 | straight home at the return altitude, if one is given, and down; else at an open height |
| jump 177 | straight to its target, once |
| loiter 17, a jump for ever, and what does not go on by itself (but ArduPilot) | no end: what follows is not judged |
| set home 179 | heights above home are open after it, and a return is not judged |
| delays, conditions, speeds, cameras, servos, regions of interest | nothing |
| splines 82, surveys without items, other complex items, all others | not judged, nor is the way to the next item |

Places of MAVLink's parameters 5 to 7: https://mavlink.io/en/messages/common.html; the files:
https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html and
https://mavlink.io/en/file_formats/#mission_plain_text_file.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.checks import finite, one_of, positive
from jaxurban.errors import InputError, readable
from jaxurban.flights.missions.dji import read_wpml, unzipped
from jaxurban.flights.missions.items import flyer_of, read_plan, read_waypoints
from jaxurban.flights.missions.lines import (
    csv_lines,
    geojson_lines,
    mission_of_lines,
    xml_lines,
)
from jaxurban.flights.missions.parts import (
    DATUMS,
    DamagedError,
    Datum,
    LonLat,
    Mission,
    check_place,
)
from jaxurban.flights.ulog import ulog_lines
from jaxurban.io.broken import BROKEN
from jaxurban.io.files import UNPACKING
from jaxurban.io.sniff import sniff
from jaxurban.io.tracks import LAT, LON, UTC, track_of
from jaxurban.settings import FlownBy

# By the content (`sniff`), else by the name.
ITEM_READERS = {
    ".plan": read_plan,
    ".waypoints": read_waypoints,
    ".mavlink": read_waypoints,
}
LINE_READERS = {
    ".kml": xml_lines,
    ".gpx": xml_lines,
    ".geojson": geojson_lines,
    ".json": geojson_lines,
    ".csv": csv_lines,
    ".txt": csv_lines,
    ".ulg": ulog_lines,
}
SUFFIXES = (*ITEM_READERS, ".kmz", ".zip", ".wpml", *LINE_READERS)
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
MOST_BYTES = 2**24  # some 20,000 items of a .plan


def read_mission(
    path: str | Path,
    *,
    heights: Datum | None = None,
    home: LonLat | None = None,
    return_altitude_m: float | None = None,
    autopilot: FlownBy | None = None,
    data: bytes | None = None,
) -> Mission:
    """Return the mission of a file: its legs, and what of it is not judged.

    Args:
      path: of the file; its name counts where its content does not say the format.
      heights: what heights are above, where the file does not say it; ``"ellipsoid"`` also in place of the geoid that
        absolute heights in KML are above.
      home: longitude and latitude in degrees, in place of the file's.
      return_altitude_m: metres above home at which the autopilot returns; left out, it is not known.
      autopilot: which one flies it, where the file does not say it; left out, either may (`Mission.other`).
      data: bytes that are read in place of the file's, of which the name alone then counts.

    Raises:
      InputError: no such file, another format, a file of more than `MOST_BYTES`, a mission that is damaged, empty or
        leads nowhere, a place that is not on the Earth, an invalid argument, an autopilot other than the file's, or
        heights of which neither the file nor ``heights`` says what they are above, or of which both say it.
    """
    path = Path(path)
    if heights is not None:
        one_of("heights", heights, DATUMS)
    if home is not None:
        try:
            lon, lat = (finite("home", degrees, "degrees") for degrees in home)
            check_place("home", lon, lat)
        except ValueError as error:
            raise InputError(
                f"home must be longitude and latitude in degrees, got {home}"
            ) from error
        home = (lon, lat)
    return_m = math.nan
    if return_altitude_m is not None:
        return_m = positive("return_altitude_m", return_altitude_m)

    with _opened(path, SUFFIXES, data) as (suffix, data):
        template = b""
        if suffix in (".kmz", ".zip"):
            suffix, data, template = unzipped(data)
        if suffix in LINE_READERS:
            lines = mission_of_lines(path.name, *LINE_READERS[suffix](path, data), heights, home)
            return replace(lines, return_altitude_m=return_m, autopilot=autopilot or "unknown")
        if heights is not None:
            raise InputError(
                f"{path.name!r} says for each item what its height is above: "
                f"leave heights={heights!r} (--heights above=) out"
            )
        if suffix == ".wpml":
            flyer_of(path.name, "dji", autopilot)
            return read_wpml(data, template, path.name, home, return_m)
        return ITEM_READERS[suffix](data, path.name, home, return_m, autopilot)


def read_way(path: str | Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the way of a mission, ``[N, 2]`` longitudes and latitudes, and sentences on what is not of it.

    Gaps are closed by straight lines. Heights play no part, so it is not asked what they are above.

    Raises:
      InputError: as of `read_mission`.
    """
    from jaxurban.flights.legs import Segments  # imported here: it brings JAX

    path = Path(path)
    if path.suffix.lower() in LINE_READERS:
        with _opened(path, LINE_READERS) as (suffix, data):
            shapes, num = LINE_READERS[suffix](path, data)
            shapes = [shape._replace(datum=shape.datum or "ground") for shape in shapes]
            mission = mission_of_lines(path.name, shapes, num, None, None)
    else:
        mission = read_mission(path)
    segments = Segments.of(mission, is_flat=True)
    return segments.lonlat[~segments.is_variant].reshape(-1, 2), mission.not_judged


def read_flight(path: str | Path) -> pd.DataFrame:
    """Return ``utc``, ``lon_deg`` and ``lat_deg`` of a flight with times: GPX, Track of KML, ULog.

    Raises:
      InputError: as of `read_mission`, or a point without a time.
    """
    path = Path(path)
    with _opened(path, LINE_READERS) as (suffix, data):
        shapes, _ = LINE_READERS[suffix](path, data)
        rows = [
            (time, *point[:2])
            for shape in shapes
            if any(shape.times)
            for time, point in zip(shape.times, shape.points, strict=True)
        ]
    if not rows:
        raise InputError(
            f"{str(path)!r} holds no times: give the speed of the flight (--speed, speed_m_s=)"
        )
    return track_of(pd.DataFrame(rows, columns=[UTC, LON, LAT]), f"the track {str(path)!r}")


@contextmanager
def _opened(
    path: Path, suffixes: Iterable[str], data: bytes | None = None
) -> Iterator[tuple[str, bytes]]:
    """Yield a mission's format, one of ``suffixes``, and its bytes or ``data``, and name its file in errors."""
    with readable(path, "a mission", "save it again in the tool that made it"):
        size = path.stat().st_size if data is None else len(data)
        if path.suffix.lower() == ".toml":
            raise InputError(
                f"{str(path)!r} is a scenario, and no mission: name a file that ends in one of {', '.join(suffixes)}"
            )
        if size > MOST_BYTES and sniff(path, data) != ".ulg":
            raise InputError(
                f"{str(path)!r} holds more than 16 MB, which no mission does: name another file"
            )
        if data is None:
            data = path.read_bytes()
        text = data.decode("utf-16").encode() if data.startswith(UTF_16) else data
        kinds = [each for each in (sniff(path, text), path.suffix.lower()) if each in suffixes]
        if not kinds:
            raise InputError(
                f"{str(path)!r} is none of the files that are read here: give one of {', '.join(suffixes)}"
            )
        try:
            yield kinds[0], data
        except (InputError, DamagedError):
            raise
        except (*BROKEN, *UNPACKING) as error:
            raise DamagedError("it is damaged, or a part is missing or of another kind") from error
