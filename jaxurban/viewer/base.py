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
    """Return the base map of maps as JSON holds it; {} where their source has none.

    ``shapes`` has a list for each kind, as "water" and "street": its lines, and the rings of its areas, each as x, y,
    x, y ... in whole metres from the maps' southwest corner. ``names`` are the rows of `_name_row`, at most
    `MOST_NAMES`, in the order in which the page tries to draw them.
    """
    frame = maps.base_map
    if frame is None:
        return {}

    # Metres from the southwest corner.
    frame = frame.to_crs(maps.grid.crs)
    corner_m = maps.grid.bounds_m[:2]
    shapes = shapely.transform(frame.geometry.to_numpy(), lambda points: points - corner_m)
    kinds = frame["kind"].to_numpy()

    # The lines of each kind; areas are joined where they touch, and drawn by the boundary of the whole.
    lines_of = {}
    for kind in dict.fromkeys(kinds):
        of_kind = shapes[kinds == kind]
        if kind in AREAS:
            of_kind = shapely.boundary([shapely.union_all(shapely.make_valid(of_kind))])
        parts = shapely.get_parts(of_kind)
        lines_of[kind] = parts[shapely.get_dimensions(parts) == 1]

    # Leave minor kinds out, one after the other, while there are too many points.
    for kind in LEFT_OUT_FIRST:
        num_points = sum(shapely.get_num_coordinates(lines).sum() for lines in lines_of.values())
        if num_points > MOST_POINTS:
            lines_of.pop(kind, None)

    # Names by kind, and within a kind those with the most room first.
    named = zip(shapes, frame["name"], kinds, strict=True)
    names = [_name_row(shape, text, kind) for shape, text, kind in named if text]
    names.sort(key=lambda row: (NAMES_FIRST.index(row[3]), -row[-1]))
    flat = {kind: [_whole_metres(line) for line in lines] for kind, lines in lines_of.items()}
    return {"shapes": flat, "names": names[:MOST_NAMES]}


def _whole_metres(line: shapely.LineString) -> list[int]:
    """Return the corners of a line as x, y, x, y ..., rounded to whole metres."""
    return np.round(shapely.get_coordinates(line)).astype(int).ravel().tolist()


def _name_row(shape: shapely.Geometry, text: str, kind: str) -> list[Any]:
    """Return a name and where it stands: x, y, text, kind, angle and room.

    It stands in the middle of the shape's largest part: level in an area or at a place, along a line otherwise. x and y
    are whole metres, the angle is in radians, counter-clockwise from the east, and the room is the length in metres
    along which the text may stand: as wide as the area, as long as the line, 0 (any) at a point.
    """
    parts = shapely.get_parts(shape)
    sizes = shapely.area(parts) if kind in AREAS else shapely.length(parts)
    largest = parts[np.argmax(sizes)]
    if kind in AREAS or kind == "place":
        middle = shapely.point_on_surface(largest)
        west, _, east, _ = shapely.bounds(largest)
        return [round(middle.x), round(middle.y), text, kind, 0, round(east - west)]

    # The direction of a line is that of its middle fifth, turned by half a turn where the text would be upside down.
    first, middle, last = shapely.line_interpolate_point(largest, [0.4, 0.5, 0.6], normalized=True)
    angle = np.arctan2(last.y - first.y, last.x - first.x)
    angle = np.pi / 2 - (np.pi / 2 - angle) % np.pi  # above -pi / 2, up to pi / 2
    room_m = shapely.length(largest)
    return [round(middle.x), round(middle.y), text, kind, round(angle, 2), round(room_m)]
