"""The geofence of a path's zones: rings to keep out of, near the path and at its altitudes."""

import numpy as np
import shapely

from jaxurban.flights.export.base import DECIMALS
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.world.extent import polygonal
from jaxurban.world.grid import Grid, covering_grid

NEAR_M = 1000.0  # zones within this of a path are in its geofence, as far as they are
SMOOTH_M = 0.01  # corners that bend an outline by less are left out


def exclusions(route: PlannedPath) -> tuple[list[np.ndarray], str]:
    """Return the zones of a path's geofence as rings, and a sentence on them and on what they leave out.

    A geofence knows no heights. So it holds only zones that reach the altitudes of the path, and no zone over or under
    which the path leads, as that would stop the flight. A zone with a hole is cut in two through the hole.

    Returns:
      Rings, each ``[N, 2]`` longitude, latitude in degrees of the corners of an area to keep out of; and the sentence.
      No rings and an empty text where the path has no zones.
    """
    if not route.zones:
        return [], ""
    low_m, high_m = route.z_m.min(), route.z_m.max()
    nearest_m, farthest_m = route.xy_m.min(axis=0) - NEAR_M, route.xy_m.max(axis=0) + NEAR_M
    surroundings = covering_grid((*nearest_m, *farthest_m), NEAR_M / 10, route.crs)
    box = shapely.box(*surroundings.bounds_m)
    line = line_of(route.xy_m)

    # The rings, from the part of each zone that is near the path.
    rings: list[np.ndarray] = []
    num_fenced = num_elsewhere = 0
    for zone in route.zones:
        part = polygonal(shapely.intersection(zone.on(surroundings), box))
        if part.is_empty:
            continue
        is_reached = zone.floor_m <= high_m and low_m <= zone.ceiling_m
        if not is_reached or part.intersects(line):
            num_elsewhere += 1
            continue
        num_fenced += 1
        polygons = without_holes(polygonal(shapely.simplify(part, SMOOTH_M)))
        rings += [ring_of(polygon, surroundings) for polygon in polygons]

    # The sentence.
    zones = "no-fly zone" if num_fenced == 1 else "no-fly zones"
    sentence = f"The geofence keeps out of {num_fenced} {zones} within {NEAR_M / 1000:g} km"
    if num_elsewhere:
        sentence += (
            f"; it has no heights, so {num_elsewhere} above or below the flight are left out"
        )
    return rings, f"{sentence}."


def ring_of(polygon: shapely.Polygon, grid: Grid) -> np.ndarray:
    """Return a polygon's corners ``[N, 2]`` in longitude and latitude, as files hold them."""
    corners = np.asarray(polygon.exterior.coords)[:-1]
    return np.round(grid.lonlat_at(corners), DECIMALS)


def without_holes(polygon: shapely.Geometry) -> list[shapely.Polygon]:
    """Return polygons without holes that together cover a polygon, or several, with holes.

    A part with a hole is cut in two along the vertical line through the middle of its first hole, until none is left.
    """
    polygons = []
    parts = list(shapely.get_parts(polygon))  # still to be looked at
    while parts:
        part = parts.pop()
        if not part.interiors:
            polygons.append(part)
            continue
        west, south, east, north = part.bounds
        cut_x = part.interiors[0].centroid.x
        for side in (
            shapely.box(west, south, cut_x, north),
            shapely.box(cut_x, south, east, north),
        ):
            parts += shapely.get_parts(polygonal(shapely.intersection(part, side))).tolist()
    return polygons
