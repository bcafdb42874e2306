"""Roofs as fences: exclusion polygons of the roofs beside a path that reach its height.

Each polygon covers its roofs, keeps off the path as the file holds it, and is as coarse as the number of vertices asks
for: neighbours are joined and corners cut outward. PX4 holds 64 points of a fence, of which it takes 63
(``DM_KEY_FENCE_POINTS_MAX`` in its dataman); ArduPilot's page on inclusion and exclusion fences names 70, which are
560 bytes, of which 63 points in polygons of three take 546.
"""

import warnings
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely

from jaxurban.checks import positive
from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.read.outlines import polygonal
from jaxurban.io.read.zone import cell_boxes, made_valid, touched_cells
from jaxurban.paths.clearance import FILE_MARGIN_M
from jaxurban.paths.export.base import waypoints
from jaxurban.paths.export.qgc_plan import exclusions, ring_of, without_holes
from jaxurban.paths.lines import line_of
from jaxurban.world.grid import Grid
from jaxurban.world.surface import stands_at

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.path import PlannedPath

MOST_VERTICES = 63  # of all polygons of a fence
# By which outlines grow before corners are cut by less.
REACHES_M = (0.5, 2.0, 5.0, 10.0, 20.0, 40.0)
APART_M = 3.0  # that outlines keep from the path as they grow
# Of the reach: half of it is taken back from what was grown, so outlines stay covered.
SIMPLER = 0.45
ROUND = 1.01  # by how much a polygon lies within its circle, and a little more
ROUNDED_M = 0.02  # by which the nearest ones grow, for the digits of a degree


class RoofFences(NamedTuple):
    """Exclusion polygons of roofs: rings ``[N, 2]`` of longitude and latitude, and a sentence on them."""

    rings: list[np.ndarray]
    note: str


class _Roofs(NamedTuple):
    """Polygons ``[R]`` in the maps' CRS, heights, whether these are guesses, and what the polygons are, and why."""

    polygons: np.ndarray
    height_m: np.ndarray
    is_guessed: np.ndarray
    called: str
    why: str


def roof_fences(route: "PlannedPath", near_m: float) -> RoofFences:
    """Return fences of the roofs within a distance of a path that reach its height less the vertical clearance.

    The outlines are those of the city that the maps were made of, where it can be read again; else the cells that such
    roofs touch. Roofs that the path itself meets cannot be fenced and are named.

    Args:
      route: with its maps; simplified as it is to be written.
      near_m: from the path to the roof.

    Raises:
      InputError: a distance that is not positive, a path without maps, or more vertices than autopilots hold.
    """
    positive("fence_roofs_m", near_m)
    if route.maps is None:
        raise InputError(
            "fence_roofs_m needs the maps of the path, and this one has none: plan it, or leave that out"
        )
    grid = route.maps.grid
    xy_m = route.xy_m
    z_m = route.z_m
    ends = np.array([*pairwise([0, *range(len(xy_m))])])  # of one point too
    legs = shapely.linestrings(xy_m[ends])
    over_m = route.settings.get("limits", {}).get("vertical_clearance_m", 0.0)
    floor_m = z_m[ends].min(axis=1) - over_m
    roofs = _roofs_near(route.maps, shapely.union_all(legs), near_m)
    of_leg, of_roof = shapely.STRtree(roofs.polygons).query(
        legs, predicate="dwithin", distance=near_m
    )
    reaching = np.unique(of_roof[stands_at(roofs.height_m[of_roof], floor_m[of_leg])])
    flown = line_of(np.stack(grid.xy_of_lonlat(*waypoints(route).lonlat.T), axis=-1))
    zones, _ = exclusions(route)
    most = MOST_VERTICES - sum(map(len, zones))
    fences, num_met = _fewest(roofs.polygons[reaching], flown, grid, most)
    rings = [ring_of(fence, grid) for fence in fences]
    num = sum(map(len, rings))
    if num > most:
        raise InputError(
            f"{len(reaching)} {roofs.called} within {near_m:g} m of the route take {num} vertices of a fence, and "
            f"autopilots hold {MOST_VERTICES}, zones included: name a smaller distance, fly higher, or split the "
            "mission"
        )
    note = (
        f"The geofence keeps out of the {roofs.called} within {near_m:g} m that reach the flight: "
        f"{len(reaching) - num_met}, {roofs.why}"
    )
    num_guessed = int(roofs.is_guessed[reaching].sum())
    if num_guessed:
        note += f", {num_guessed} of guessed height"
    if fences:
        note += f", in {num} vertices; the nearest is {shapely.distance(fences, flown).min():.1f} m from the route"
    if num_met:
        note += f"; {num_met} that the route itself meets are left out, as a fence would stop it"
    return RoofFences(rings, f"{note}.")


def _roofs_near(maps: "MetricMaps", line: shapely.Geometry, near_m: float) -> _Roofs:
    """Return the roofs within a distance of a line and some beside them."""
    from jaxurban.maps.sources import city_of

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GuessWarning)  # the maps hold what the city guesses
        try:
            buildings = city_of(maps).buildings
        except InputError:
            buildings = None
    if buildings is not None:
        near = buildings.take(shapely.dwithin(buildings.polygons, line, near_m))
        return _Roofs(near.polygons, near.height_m, near.is_guessed, "roofs", "by their outlines")
    grid = maps.grid
    roof_m = maps.m("roof_touched")
    near_cells = touched_cells(shapely.buffer(line, near_m * ROUND), grid)
    at = np.argwhere(near_cells & (roof_m > 0))
    rows, cols = at.T
    guessed = (
        maps.m("roof_guessed") if "roof_guessed" in maps.ds else np.zeros(grid.shape, np.uint8)
    )
    return _Roofs(
        cell_boxes(grid, at, 1),
        roof_m[rows, cols].astype(float),
        guessed[rows, cols] == 1,
        f"cells of {grid.resolution_m:g} m with roofs",
        "as the city that the maps were made of cannot be read again",
    )


def _fewest(
    roofs: np.ndarray, line: shapely.Geometry, grid: Grid, most: int
) -> tuple[list[shapely.Polygon], int]:
    """Return the least coarse fences whose vertices are within a number, if any are, and how many roofs have none."""
    for coarsest in range(len(REACHES_M)):
        fences, num_met = _fences(roofs, line, grid, REACHES_M[coarsest::-1])
        if sum(len(fence.exterior.coords) - 1 for fence in fences) <= most:
            break
    return fences, num_met


def _fences(
    roofs: np.ndarray, line: shapely.Geometry, grid: Grid, reaches_m: tuple[float, ...]
) -> tuple[list[shapely.Polygon], int]:
    """Return fences, each grown by the first reach under which it covers its roofs, and how many roofs have none."""
    fences: list[shapely.Polygon] = []
    kept_free = shapely.buffer(line, APART_M * 1.1, join_style="mitre", quad_segs=2)
    left = roofs[~shapely.dwithin(roofs, line, FILE_MARGIN_M + 2 * ROUNDED_M)]
    num_met = len(roofs) - len(left)
    for reach_m in (*reaches_m, 0.0):
        far = left[~shapely.intersects(left, kept_free)] if reach_m else left
        grown = shapely.buffer(far, max(reach_m, ROUNDED_M), join_style="mitre")
        joined = shapely.union_all(shapely.make_valid(grown))  # mitres may cross each other
        parts = made_valid(shapely.buffer(joined, -reach_m / 2, join_style="mitre"))
        if reach_m:
            rings = shapely.get_exterior_ring(shapely.get_parts(parts))
            simple = shapely.simplify(shapely.polygons(rings), reach_m * SIMPLER)
            parts = polygonal(shapely.difference(simple, kept_free))
        written = np.array([_as_written(part, grid) for part in without_holes(parts)])
        apart_m = APART_M if reach_m else FILE_MARGIN_M
        is_apart = shapely.distance(written, line) >= apart_m
        fences += written[is_apart & shapely.is_valid(written)].tolist()
        left = left[~shapely.covered_by(left, shapely.union_all(fences))]
    return fences, num_met + len(left)


def _as_written(polygon: shapely.Polygon, grid: Grid) -> shapely.Polygon:
    return shapely.Polygon(np.stack(grid.xy_of_lonlat(*ring_of(polygon, grid).T), axis=-1))
