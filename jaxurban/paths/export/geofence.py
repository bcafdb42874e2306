"""The no-fly zones near a path as a geofence: polygons without holes and without heights."""

import math
from typing import TYPE_CHECKING

import numpy as np
import shapely

from jaxurban.io.read.outlines import polygonal
from jaxurban.paths.export.base import DECIMALS
from jaxurban.world.grid import Grid

if TYPE_CHECKING:
    from jaxurban.paths.path import PlannedPath

NEAR_M = 1000.0  # zones within this of a path are in its geofence, as far as they are
SMOOTH_M = 0.01  # corners that bend an outline by less are left out


def exclusions(route: "PlannedPath") -> tuple[list[np.ndarray], str]:
    """Return the outlines ``[N, 2]`` (longitude, latitude) to keep out of, and a sentence on what they leave out.

    A geofence knows no heights. So it holds the zones that the path was planned around whose floor and ceiling meet
    the path's altitudes, but for those that it passes over or under on its way, which would stop it. Where a zone has a
    hole it is cut in two through it.
    """
    if not route.zones:
        return [], ""
    low_m, high_m = float(np.min(route.z_m)), float(np.max(route.z_m))
    near, line = _surroundings(route), _line(route.xy_m)
    rings: list[np.ndarray] = []
    num_held = num_elsewhere = 0
    for zone in route.zones:
        part = polygonal(shapely.intersection(zone.on(near), shapely.box(*near.bounds_m)))
        if part.is_empty:
            continue
        if not (zone.floor_m <= high_m and low_m <= zone.ceiling_m) or part.intersects(line):
            num_elsewhere += 1
            continue
        num_held += 1
        for whole in without_holes(polygonal(shapely.simplify(part, SMOOTH_M))):
            corners = np.asarray(whole.exterior.coords)[:-1]
            rings.append(np.round(np.stack(near.lonlat_of_xy(*corners.T), axis=-1), DECIMALS))
    said = f"The geofence keeps out of {num_held} no-fly zone{'s' * (num_held != 1)} within {NEAR_M / 1000:g} km"
    if num_elsewhere:
        said += f"; it has no heights, so {num_elsewhere} above or below the flight are left out"
    return rings, f"{said}."


def without_holes(polygon: shapely.Geometry) -> list[shapely.Polygon]:
    """Return polygons without holes that cover the same: each with a hole is cut in two, up and down through it."""
    whole: list[shapely.Polygon] = []
    parts = list(shapely.get_parts(polygon))
    while parts:
        part = parts.pop()
        if not part.interiors:
            whole.append(part)
            continue
        west, south, east, north = part.bounds
        x = part.interiors[0].centroid.x
        for half in (shapely.box(west, south, x, north), shapely.box(x, south, east, north)):
            parts += shapely.get_parts(polygonal(shapely.intersection(part, half))).tolist()
    return whole


def _surroundings(route: "PlannedPath") -> Grid:
    """Return the land within `NEAR_M` of a path's box, as a coarse grid."""
    side_m = NEAR_M / 10
    west, south = (math.floor((low - NEAR_M) / side_m) for low in route.xy_m.min(axis=0).tolist())
    east, north = (math.ceil((high + NEAR_M) / side_m) for high in route.xy_m.max(axis=0).tolist())
    return Grid(route.crs, side_m, first_row=south, first_col=west, num_rows=north - south, num_cols=east - west)


def _line(xy_m: np.ndarray) -> shapely.LineString:
    return shapely.LineString(xy_m if len(xy_m) > 1 else np.repeat(xy_m, 2, axis=0))
