"""Outlines of all buildings as the page draws them: of the city behind the maps, else of the roofs in the maps."""

import numpy as np
import shapely
from rasterio.features import shapes

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.viewer.tiles import packed
from jaxurban.world.footprints import Footprints

TOLERANCE_M = 1.0  # outlines are simplified to it
STEP_M = 0.5  # of corners
MOST_CORNERS = 400_000  # that are sent, of the largest buildings first


def outlines_of(maps: MetricMaps, buildings: Footprints | None) -> bytes:
    """Return the outlines of buildings, as `tile_bytes` packs values.

    The number of rings comes first, then of each ring its number of corners, its height in metres above the ground and
    1 where that is guessed, else 0; then of all corners, ring after ring, the steps to the east and those to the north
    from the corner before, in units of `STEP_M`. The first step is from the maps' southwest corner.

    Args:
      maps: whose region is drawn.
      buildings: of the city, in the maps' CRS; None: they are drawn as the maps hold roofs.
    """
    if buildings is None:
        polygons, height_m, is_guessed = _from_roofs(maps)
    else:
        is_inside = shapely.intersects(buildings.polygons, shapely.box(*maps.grid.bounds_m))
        polygons = shapely.simplify(buildings.polygons[is_inside], TOLERANCE_M)
        height_m = buildings.height_m[is_inside]
        is_guessed = buildings.is_guessed[is_inside]
    order = np.argsort(-shapely.area(polygons), kind="stable")
    largest = np.cumsum(shapely.get_num_coordinates(polygons[order])) <= MOST_CORNERS
    chosen = np.sort(order[largest])
    parts, of_polygon = shapely.get_parts(polygons[chosen], return_index=True)
    rings, of_part = shapely.get_rings(parts, return_index=True)
    building = chosen[of_polygon[of_part]]
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    corners = np.round((shapely.get_coordinates(rings) - corner_m) / STEP_M)
    steps = np.diff(corners, axis=0, prepend=0)
    facts = [shapely.get_num_coordinates(rings), height_m[building], is_guessed[building]]
    return packed(np.concatenate([[len(rings)], *facts, *steps.T]))


def _from_roofs(maps: MetricMaps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return polygons ``[N]`` around the cells with roofs that reach equally many of the maps' altitudes.

    Their heights ``[N]`` are the highest roof among all of these cells, so that each reaches the altitudes that it
    reaches in the maps; the last is whether a height is guessed.
    """
    grid = maps.grid
    roof_m = np.nan_to_num(maps.m("roof"))
    has_guesses = "roof_guessed" in maps.ds
    is_guessed = maps.m("roof_guessed") if has_guesses else np.zeros(grid.shape)
    level = np.digitize(roof_m, maps.altitudes_m)
    kind = (2 * level + (is_guessed == 1)).astype(np.int16)
    traced = list(shapes(kind, mask=roof_m > 0))  # in cells from the southwest corner
    polygons = np.array([shapely.geometry.shape(shape) for shape, _ in traced], dtype=object)
    corner_m = np.array([grid.x_min_m, grid.y_min_m])
    polygons = shapely.transform(polygons, lambda cells: corner_m + grid.resolution_m * cells)
    of_polygon = np.array([number for _, number in traced], dtype=int)
    highest_m = np.zeros(2 * len(maps.altitudes_m) + 2)
    np.maximum.at(highest_m, kind, roof_m)
    return polygons, highest_m[of_polygon], of_polygon % 2 == 1
