"""Routes from files: lines that someone flew, drew or planned."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban import wings
from jaxurban.checks import finite
from jaxurban.errors import InputError, SkippedRouteWarning, warn

ALTITUDE_PROPERTY = "altitude_m"
TIME_OF_DAY_PROPERTY = "time_of_day"
TIME_PROPERTY = "time"
LINES = (shapely.GeometryType.LINESTRING, shapely.GeometryType.MULTILINESTRING)
PROPERTIES = ("name", ALTITUDE_PROPERTY, TIME_OF_DAY_PROPERTY, TIME_PROPERTY)


@dataclass(frozen=True, eq=False)
class Route:
    """A line from a file. ``N`` points.

    Attributes:
      lonlat: ``[N, 2]`` longitude, latitude in degrees.
      name: its ``name`` property, or its number in the file, from 1.
      altitude_m, time_of_day, time: of the feature's properties (of paths that jaxurban wrote as GeoJSON: of
        their ``settings``), None where they are not given.
      settings: of paths that jaxurban wrote, those they were planned under; else empty.
    """

    lonlat: np.ndarray
    name: str
    altitude_m: float | None = None
    time_of_day: str | None = None
    time: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


def read_routes(file: str | Path) -> list[Route]:
    """Return the lines of a vector file, each part of a MultiLineString a route of its own.

    Warns:
      SkippedRouteWarning: features that are no lines of finite places, and are left out.

    Raises:
      InputError: no such file, no line in it, or an altitude that is not a number.
    """
    routes = []
    num_others = 0
    layers = (frame.to_crs("EPSG:4326") for frame in wings.open_layers(file, "routes"))
    features = (
        feature
        for frame in layers
        for feature in zip(frame.geometry, frame.to_dict("records"), strict=True)
    )
    for number, (shape, row) in enumerate(features, start=1):  # through all layers
        is_finite = np.isfinite(shapely.get_coordinates(shape)).all()
        if shapely.get_type_id(shape) not in LINES or not is_finite:
            num_others += 1
            continue

        # The settings of jaxurban's own paths, an object or its JSON text; properties of the feature win over them.
        settings = row.get("settings")
        if isinstance(settings, str):
            with suppress(ValueError, RecursionError):
                settings = json.loads(settings)
        settings = dict(settings) if isinstance(settings, dict) else {}
        facts = settings | {key: row[key] for key in PROPERTIES if not pd.isna(row.get(key))}
        facts.setdefault("name", row.get("Name"))  # of KML

        parts = [part for part in shapely.get_parts(shape) if part.length > 0]
        for part_number, part in enumerate(parts, start=1):
            name = str(facts.get("name") or number)
            if len(parts) > 1:
                name += f".{part_number}"
            altitude_m = facts.get(ALTITUDE_PROPERTY)
            if altitude_m is not None:
                altitude_m = finite(
                    f"{ALTITUDE_PROPERTY} of route {name!r} of {str(file)!r}", altitude_m, "metres"
                )
            times = facts.get(TIME_OF_DAY_PROPERTY), facts.get(TIME_PROPERTY)
            lonlat = shapely.get_coordinates(part)
            routes.append(Route(lonlat, name, altitude_m, *times, settings))

    if not routes:
        raise InputError(
            f"{str(file)!r} holds no line of finite places: give routes as LineString features"
        )
    if num_others:
        warn(
            f"{num_others} of the features of {str(file)!r} are not lines of finite places and were left out",
            SkippedRouteWarning,
        )
    return routes
