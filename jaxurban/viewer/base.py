"""The base map as the page draws it below the metric: streets, water, parks and their names, in metres."""

from typing import Any

import numpy as np
import shapely

from jaxurban.maps.metric_maps import MetricMaps

AREAS = ("water", "park")
MOST_POINTS = 150_000  # that are sent; beyond them paths are left out, then minor streets
LEFT_OUT_FIRST = ("path", "street")
MOST_NAMES = 2000  # the longest streets and largest areas first
NAMES_FIRST = ("place", "water", "park", "major", "street", "rail", "path")  # kinds, in order


def base_of(maps: MetricMaps) -> dict[str, Any]:
    """Return the base map of maps as JSON holds it, empty where their source has none.

    ``shapes`` are, by kind, lists of x, y, x, y ... in whole metres from the maps' southwest corner: rings of areas and
    lines. ``names`` are rows of x, y, text, kind, angle (radians, counter-clockwise from the east) and length in
    metres, the room along which the text may stand (0: any), those that are drawn first at the beginning.
    """
    frame = maps.base_map
    if frame is None or frame.empty:
        return {}
    frame = frame.to_crs(maps.grid.crs)
    corner_m = maps.grid.x_min_m, maps.grid.y_min_m
    shapes = shapely.transform(frame.geometry.to_numpy(), lambda points: points - corner_m)
    kinds = frame["kind"].to_numpy()
    lines_of = {}
    for kind in dict.fromkeys(kinds):
        of_kind = shapes[kinds == kind]
        if kind in AREAS:
            of_kind = shapely.boundary([shapely.union_all(shapely.make_valid(of_kind))])
        parts = shapely.get_parts(of_kind)
        lines_of[kind] = parts[shapely.get_dimensions(parts) == 1]
    for kind in LEFT_OUT_FIRST:
        num_points = sum(shapely.get_num_coordinates(lines).sum() for lines in lines_of.values())
        if num_points > MOST_POINTS:
            lines_of.pop(kind, None)
    names = []
    for shape, text, kind in zip(shapes, frame["name"], kinds, strict=True):
        if text:
            names.append(_name_row(shape, text, kind))
    names.sort(key=lambda row: (NAMES_FIRST.index(row[3]), -row[5]))
    flat = {kind: [_whole_metres(line) for line in lines] for kind, lines in lines_of.items()}
    return {"shapes": flat, "names": names[:MOST_NAMES]}


def _whole_metres(line: shapely.LineString) -> list[int]:
    return np.round(shapely.get_coordinates(line)).astype(int).ravel().tolist()


def _name_row(shape: shapely.Geometry, text: str, kind: str) -> list[Any]:
    """Return the row of a name: in the middle of the longest part, along it if it is a line."""
    parts = shapely.get_parts(shape)
    sizes = shapely.area(parts) if kind in AREAS else shapely.length(parts)
    largest = parts[np.argmax(sizes)]
    if kind in AREAS or kind == "place":
        middle = shapely.point_on_surface(largest)
        west, _, east, _ = shapely.bounds(largest)
        return [round(middle.x), round(middle.y), text, kind, 0, round(east - west)]
    first, middle, last = shapely.line_interpolate_point(largest, [0.4, 0.5, 0.6], normalized=True)
    angle = np.arctan2(last.y - first.y, last.x - first.x)
    angle = np.pi / 2 - (np.pi / 2 - angle) % np.pi  # never upside down
    room_m = shapely.length(largest)
    return [round(middle.x), round(middle.y), text, kind, round(float(angle), 2), round(room_m)]
