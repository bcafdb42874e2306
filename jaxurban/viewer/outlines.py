"""Outlines of all that stands as the page draws them: of the city behind the maps, else of the roofs in the maps."""

import numpy as np
import shapely
from rasterio.features import shapes

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.viewer.tiles import packed
from jaxurban.world.footprints import Footprints

TOLERANCE_M = 1.0  # outlines are simplified to it
STEP_M = 0.5  # of corners
MOST_CORNERS = 400_000  # that are sent, of the largest buildings first


def outlines_of(maps: MetricMaps, standing: Footprints | None) -> bytes:
    """Return the outlines of what stands as `packed` numbers, of the largest ones where all have over `MOST_CORNERS`.

    The number of rings, R, comes first. Then come three rows of R numbers: how many corners each ring has, its height
    in metres above the ground, and 1 where that height is guessed, else 0. Last come two rows with a number for each
    corner, ring after ring: the steps to the east and to the north from the corner before, in units of `STEP_M`, of
    the very first corner from the maps' southwest corner.

    Args:
      maps: whose region is drawn.
      standing: of the city, in the maps' CRS; None: outlines are drawn around the roofs in the maps.
    """
    # What stands in the region.
    if standing is None:
        polygons, height_m, is_guessed = _from_roofs(maps)
    else:
        inside = standing.inside(maps.grid.bounds_m)
        polygons = shapely.simplify(inside.polygons, TOLERANCE_M)
        height_m = inside.height_m
        is_guessed = inside.is_guessed

    # The largest ones, in their order.
    order = np.argsort(-shapely.area(polygons), kind="stable")
    largest = np.cumsum(shapely.get_num_coordinates(polygons[order])) <= MOST_CORNERS
    chosen = np.sort(order[largest])

    # Their rings, and the building of each ring.
    parts, of_polygon = shapely.get_parts(polygons[chosen], return_index=True)
    rings, of_part = shapely.get_rings(parts, return_index=True)
    building = chosen[of_polygon[of_part]]

    # Steps between corners, the first one from 0, 0.
    corners = np.round((shapely.get_coordinates(rings) - maps.grid.bounds_m[:2]) / STEP_M)
    steps = np.diff(corners, axis=0, prepend=0)
    facts = [shapely.get_num_coordinates(rings), height_m[building], is_guessed[building]]
    return packed(np.concatenate([[len(rings)], *facts, *steps.T]))


def _from_roofs(maps: MetricMaps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return polygons around cells with roofs, from the maps alone.

    Cells that touch are in one polygon if their roofs reach equally many of the maps' altitudes and are both guessed or
    both not.

    Returns:
      ``[N]`` the polygons; ``[N]`` their heights in metres, each that of the highest of all roofs that reach as many
      altitudes, so that a polygon reaches the altitudes that its roofs reach; ``[N]`` whether the height is guessed.
    """
    # A number for each kind of roof: twice the number of altitudes that it reaches, and 1 more if it is guessed.
    grid = maps.grid
    roof_m = np.nan_to_num(maps.m("roof"))
    has_guesses = "roof_guessed" in maps.ds
    is_guessed = maps.m("roof_guessed") if has_guesses else np.zeros(grid.shape)
    level = np.digitize(roof_m, maps.altitudes_m)
    kind = (2 * level + (is_guessed == 1)).astype(np.int16)

    # Polygons around cells of a kind.
    traced = list(shapes(kind, mask=roof_m > 0))  # in cells from the southwest corner
    polygons = np.array([shapely.geometry.shape(shape) for shape, _ in traced], dtype=object)
    polygons = shapely.transform(
        polygons, lambda cells: grid.bounds_m[:2] + grid.resolution_m * cells
    )
    polygon_kind = np.array([number for _, number in traced], dtype=int)

    # The highest roof of each kind.
    highest_m = np.zeros(2 * len(maps.altitudes_m) + 2)
    np.maximum.at(highest_m, kind, roof_m)
    return polygons, highest_m[polygon_kind], polygon_kind % 2 == 1
