"""Roofs as fences: exclusion polygons of the roofs beside a path that reach its height.

Each polygon covers its roofs, keeps off the path as the file holds it, and is as coarse as the number of vertices asks
for: neighbours are joined and corners cut outward. PX4 holds 64 points of a fence, of which it takes 63
(``DM_KEY_FENCE_POINTS_MAX`` in its dataman); ArduPilot's page on inclusion and exclusion fences names 70, which are
560 bytes, of which 63 points in polygons of three take 546.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.checks import positive
from jaxurban.errors import InputError
from jaxurban.flights.contacts import buildings_of
from jaxurban.flights.export.base import waypoints
from jaxurban.flights.export.fences import exclusions, ring_of, without_holes
from jaxurban.io.zone import made_valid
from jaxurban.kernels.tolerances import FILE_MARGIN_M
from jaxurban.maps.sources import standing_on
from jaxurban.paths.lines import line_of
from jaxurban.paths.path import PlannedPath
from jaxurban.world.extent import polygonal
from jaxurban.world.grid import Grid
from jaxurban.world.surface import stands_at

MOST_VERTICES = 63  # of all polygons of a fence
# By which outlines grow before corners are cut by less.
REACHES_M = (0.5, 2.0, 5.0, 10.0, 20.0, 40.0)
APART_M = 3.0  # that outlines keep from the path as they grow
# Of the reach: half of it is taken back from what was grown, so outlines stay covered.
SIMPLER = 0.45
ROUNDED_M = 0.02  # by which the nearest ones grow, for the digits of a degree


class RoofFences(NamedTuple):
    """Exclusion polygons of roofs: rings ``[N, 2]`` of longitude and latitude, and a sentence on them."""

    rings: list[np.ndarray]
    note: str


def roof_fences(route: PlannedPath, near_m: float) -> RoofFences:
    """Return fences of the roofs within a distance of a path that reach its height less the vertical clearance.

    The outlines are those of the city that the maps were made of, where it can be read again; else the cells that such
    roofs touch. Roofs that the path itself meets cannot be fenced, and the sentence counts them.

    Args:
      route: with its maps; simplified as it is to be written.
      near_m: the distance in plan.

    Raises:
      InputError: a distance that is not positive, a path without maps, or more vertices than autopilots hold.
    """
    positive("fence_roofs_m", near_m)
    if route.maps is None:
        raise InputError(
            "fence_roofs_m needs the maps of the path, and this one has none: plan it, or leave that out"
        )

    # The roofs that a leg passes within the distance, and that reach its height less the vertical clearance.
    grid = route.maps.grid
    xy_m = route.xy_m
    # The first leg has no length, so that there is one of a lone point too.
    ends = np.array(list(pairwise([0, *range(len(xy_m))])))
    legs = shapely.linestrings(xy_m[ends])
    vertical_m = route.settings.get("limits", {}).get("vertical_clearance_m", 0.0)
    floor_m = route.z_m[ends].min(axis=1) - vertical_m
    standing = standing_on(route.maps)
    city = standing.city
    roofs = buildings_of(route.maps, city)
    leg, roof = shapely.STRtree(roofs.polygons).query(legs, predicate="dwithin", distance=near_m)
    reaching = np.unique(roof[stands_at(roofs.top_m[roof], floor_m[leg])])

    # Their fences, with the vertices that zones leave, around the path as the file holds it.
    flown = line_of(grid.xy_at(waypoints(route).lonlat))
    zone_rings, _ = exclusions(route)
    most_vertices = MOST_VERTICES - sum(map(len, zone_rings))
    fences, num_met = _fewest(roofs.polygons[reaching], flown, grid, most_vertices)
    rings = [ring_of(fence, grid) for fence in fences]
    num_vertices = sum(map(len, rings))
    if num_vertices > most_vertices:
        raise InputError(
            f"{len(reaching)} roofs within {near_m:g} m of the route take {num_vertices} vertices of a fence, "
            f"and autopilots hold {MOST_VERTICES}, zones included: name a smaller distance, fly higher, or split the "
            "mission"
        )

    # The sentence.
    note = (
        f"The geofence keeps out of the roofs within {near_m:g} m that reach the flight: "
        f"{len(reaching) - num_met} ({standing.outlines})"
    )
    num_guessed = roofs.is_guessed[reaching].sum()
    if num_guessed:
        note += f", {num_guessed} of guessed height"
    if fences:
        nearest_m = shapely.distance(fences, flown).min()
        note += f", in {num_vertices} vertices; the nearest is {nearest_m:.1f} m from the route"
    if num_met:
        note += f"; {num_met} that the route itself meets are left out, as a fence would stop it"
    return RoofFences(rings, f"{note}.")


def _fewest(
    roofs: np.ndarray, line: shapely.Geometry, grid: Grid, most: int
) -> tuple[list[shapely.Polygon], int]:
    """Return the least coarse fences that have few enough vertices, and how many roofs have no fence.

    Where even the coarsest have too many, these are returned.

    Args:
      roofs: ``[R]`` polygons in the grid's CRS.
      line: the path as its file holds it, in the grid's CRS.
      grid: of the maps.
      most: the number of vertices that all fences together may have.
    """
    for coarsest in range(len(REACHES_M)):
        fences, num_unfenced = _fences(roofs, line, grid, REACHES_M[coarsest::-1])
        num_vertices = shapely.count_coordinates(fences) - len(fences)  # rings repeat their first
        if num_vertices <= most:
            break
    return fences, num_unfenced


def _fences(
    roofs: np.ndarray, line: shapely.Geometry, grid: Grid, reaches_m: tuple[float, ...]
) -> tuple[list[shapely.Polygon], int]:
    """Return fences of roofs, and how many roofs have none: those on the path, and those that no fence covers.

    Roofs are grown by a reach, joined and simplified. A fence must keep off the path and cover whole roofs; roofs that
    stay uncovered are tried again with the next reach, and at last by themselves, hardly grown.

    Args:
      roofs: ``[R]`` polygons in the grid's CRS.
      line: the path as its file holds it, in the grid's CRS.
      grid: of the maps.
      reaches_m: the reaches, the coarsest first.
    """
    fences: list[shapely.Polygon] = []
    strip = shapely.buffer(line, APART_M * 1.1, join_style="mitre", quad_segs=2)  # kept free
    uncovered = roofs[~shapely.dwithin(roofs, line, FILE_MARGIN_M + 2 * ROUNDED_M)]
    num_met = len(roofs) - len(uncovered)
    for reach_m in (*reaches_m, 0.0):
        # Grow and join the roofs that stand clear of the path, and take half of the growth back.
        taken = uncovered[~shapely.intersects(uncovered, strip)] if reach_m else uncovered
        grown = shapely.buffer(taken, max(reach_m, ROUNDED_M), join_style="mitre")
        joined = shapely.union_all(shapely.make_valid(grown))  # mitres may cross each other
        parts = made_valid(shapely.buffer(joined, -reach_m / 2, join_style="mitre"))

        # Fill holes, cut corners by less than the other half, and cut the path's strip out again.
        if reach_m:
            rings = shapely.get_exterior_ring(shapely.get_parts(parts))
            simple = shapely.simplify(shapely.polygons(rings), reach_m * SIMPLER)
            parts = polygonal(shapely.difference(simple, strip))

        # Keep fences that are off the path when they are rounded as in the file.
        corners_m = [grid.xy_at(ring_of(part, grid)) for part in without_holes(parts)]
        written = np.array([shapely.Polygon(ring_m) for ring_m in corners_m])
        apart_m = APART_M if reach_m else FILE_MARGIN_M
        is_apart = shapely.distance(written, line) >= apart_m
        fences += written[is_apart & shapely.is_valid(written)].tolist()
        uncovered = uncovered[~shapely.covered_by(uncovered, shapely.union_all(fences))]
    return fences, num_met + len(uncovered)
