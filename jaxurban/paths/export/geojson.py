"""GeoJSON (RFC 7946): a FeatureCollection of one LineString a path, and one more for each segment of a report.

Coordinates are longitude and latitude only, since a third one would be a height above the ellipsoid; the altitudes
above ground and all else that is known of the path are properties (``altitude_m``, ``z_m`` of each point, ``cost``,
``metrics`` ..., with the numbers of these two as ``cost_gps``, ``mean_gps`` ... too; ``cautions`` as sentences;
``height_reference`` says what the heights count from; over terrain, ``ground_m`` is the elevation
below each). With a report its facts are properties too, and each of its segments is a LineString more (``segment``:
1, 2 ...). Of several paths each has a ``name``.
"""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban.paths.export.base import Z_DECIMALS, Named, facts_of, positions, upward

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport

GROUND_REFERENCE = "ground_m is in metres above the zero of the terrain file, whatever its vertical datum is"


def _feature(properties: Mapping[str, Any], lonlat: np.ndarray) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": positions(lonlat)}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def to_geojson(routes: Named, report: "RouteReport | None") -> bytes:
    """Return paths as GeoJSON."""
    features = []
    for name, route in routes:
        facts, segments = facts_of(route, report, is_alone=len(routes) == 1)
        # A GIS takes nested properties for text.
        facts |= {f"cost_{name}": value for name, value in facts.get("cost_by_layer", {}).items()}
        facts |= {f"mean_{name}": value for name, value in facts.get("metrics", {}).items()}
        heights: dict[str, Any] = {"z_m": upward(route.z_m).tolist()}
        if route.ground is not None:
            elevation_m = np.interp(np.arange(len(route.z_m)), route.ground.at, route.ground.elevation_m)
            heights |= {"ground_m": np.round(elevation_m, Z_DECIMALS).tolist(), "ground_reference": GROUND_REFERENCE}
        features.append(_feature(({"name": name} if name else {}) | facts | heights, route.lonlat))
        lines = () if report is None else report.lines
        features += [_feature(segment, line) for segment, line in zip(segments, lines, strict=True)]
    collection = {"type": "FeatureCollection", "features": features}
    return (json.dumps(collection, allow_nan=False) + "\n").encode()
