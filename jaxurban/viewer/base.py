"""The base map as the page draws it below the metric: streets, water, parks and their names, in metres."""

from typing import Any

import numpy as np
import shapely

from jaxurban.maps.metric_maps import MetricMaps

AREAS = ("water", "park")
MOST_POINTS = 150_000  # that are sent; beyond them paths are left out, then minor streets
LEFT_OUT_FIRST = ("path", "street")
MOST_NAMES = 2000  # the longest streets and largest areas first


def base_of(maps: MetricMaps) -> dict[str, Any]:
    """Return the base map of maps as JSON holds it, empty where their source has none.

    ``shapes`` are, by kind, lists of x, y, x, y ... in whole metres from the maps' southwest corner: rings of areas and
    lines. ``names`` are rows of x, y, text, kind, angle (radians, counter-clockwise from the east) and length in
    metres, the room along which the text may stand (0: any), those that are drawn first at the beginning.
    """
    frame = maps.base_map
    if frame is None or frame.empty:
        return {}
    frame, corner_m = frame.to_crs(maps.grid.crs), (maps.grid.x_min_m, maps.grid.y_min_m)
    shapes = shapely.transform(frame.geometry.to_numpy(), lambda points: points - corner_m)
    kinds = frame["kind"].to_numpy()
    parts = {}
    for kind in dict.fromkeys(kinds):
        of_kind = shapes[kinds == kind]
        if kind in AREAS:
            of_kind = shapely.boundary([shapely.union_all(shapely.make_valid(of_kind))])
        parts[kind] = [
            line for line in shapely.get_parts(of_kind) if shapely.get_dimensions(line) == 1
        ]
    for kind in LEFT_OUT_FIRST:
        if (
            sum(
                map(
                    shapely.get_num_coordinates,
                    (line for lines in parts.values() for line in lines),
                )
            )
            > MOST_POINTS
        ):
            parts.pop(kind, None)
    flat = {kind: [_whole(line) for line in lines] for kind, lines in parts.items()}
    named = [_name(*row) for row in zip(shapes, frame["name"], kinds, strict=True) if row[1]]
    rank = {
        kind: k
        for k, kind in enumerate(("place", "water", "park", "major", "street", "rail", "path"))
    }
    named.sort(key=lambda row: (rank[row[3]], -row[5]))
    return {"shapes": flat, "names": named[:MOST_NAMES]}


def _whole(line: shapely.LineString) -> list[int]:
    return np.round(shapely.get_coordinates(line)).astype(int).ravel().tolist()


def _name(shape: shapely.Geometry, text: str, kind: str) -> list[Any]:
    """Return the row of a name: in the middle of the longest part, along it if it is a line."""
    parts = shapely.get_parts(shape)
    largest = parts[np.argmax(shapely.area(parts) if kind in AREAS else shapely.length(parts))]
    if kind in AREAS or kind == "place":
        at = shapely.point_on_surface(largest)
        west, _, east, _ = shapely.bounds(largest)
        return [round(at.x), round(at.y), text, kind, 0, round(east - west)]
    first, at, last = shapely.line_interpolate_point(largest, [0.4, 0.5, 0.6], normalized=True)
    angle = np.arctan2(last.y - first.y, last.x - first.x)
    angle = (
        angle + np.pi if angle <= -np.pi / 2 else angle - np.pi if angle > np.pi / 2 else angle
    )  # never head down
    return [
        round(at.x),
        round(at.y),
        text,
        kind,
        round(float(angle), 2),
        round(shapely.length(largest)),
    ]
