"""Outlines of all that stands as the page draws them: of the city behind the maps, else of the roofs in the maps."""

import numpy as np
import shapely
from rasterio.features import shapes

from jaxurban.draw.metrics import group_numbers
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.variables import GROUP_COLOURS, GROUP_NUMBERS
from jaxurban.viewer.tiles import packed
from jaxurban.world.footprints import Footprints

TOLERANCE_M = 1.0  # outlines are simplified to it
STEP_M = 0.5  # of corners
MOST_CORNERS = 400_000  # that are sent, of the largest buildings first


def packed_outlines(maps: MetricMaps, standing: Footprints | None) -> bytes:
    """Return the outlines of what stands as `packed` numbers, of the largest ones where all have over `MOST_CORNERS`.

    The number of rings, R, comes first. Then come four rows of R numbers: how many corners each ring has, its height
    in metres above the ground (where that is not known, its bound), 1 where it is guessed, else 0, and the number of
    its group in `GROUP_COLOURS`. Holes run against their outer rings. Last come two rows with a number for each
    corner, ring after ring: the steps to the east and to the north from the corner before, in units of `STEP_M`, of
    the very first corner from the maps' southwest corner.

    Args:
      maps: whose region is drawn.
      standing: of the city, in the maps' CRS; None: outlines are drawn around the roofs in the maps.
    """
    # What stands in the region.
    if standing is None:
        polygons, *facts = _from_roofs(maps)
    else:
        inside = standing.inside(maps.grid.bounds_m)
        polygons = shapely.simplify(inside.polygons, TOLERANCE_M)
        height_m = np.where(inside.height_m > 0, inside.height_m, inside.upper_m)
        group = [GROUP_NUMBERS[kind] for kind in inside.kinds]
        facts = [height_m, inside.is_guessed, np.array(group, int)]

    # The largest ones, in their order.
    order = np.argsort(-shapely.area(polygons), kind="stable")
    largest = np.cumsum(shapely.get_num_coordinates(polygons[order])) <= MOST_CORNERS
    chosen = np.sort(order[largest])

    # Their rings, and the building of each ring.
    polygons = shapely.orient_polygons(polygons[chosen])
    parts, of_polygon = shapely.get_parts(polygons, return_index=True)
    rings, of_part = shapely.get_rings(parts, return_index=True)
    building = chosen[of_polygon[of_part]]

    # Steps between corners, the first one from 0, 0.
    corners = np.round((shapely.get_coordinates(rings) - maps.grid.bounds_m[:2]) / STEP_M)
    steps = np.diff(corners, axis=0, prepend=0)
    rows = [shapely.get_num_coordinates(rings), *(fact[building] for fact in facts)]
    return packed(np.concatenate([[len(rings)], *rows, *steps.T]))


def _from_roofs(maps: MetricMaps) -> tuple[np.ndarray, ...]:
    """Return polygons around cells with roofs, from the maps alone.

    Cells that touch are in one polygon if their roofs reach equally many of the maps' altitudes, are both guessed or
    both not, and of one group.

    Returns:
      ``[N]`` the polygons; ``[N]`` their heights in metres, each that of the highest of all roofs that reach as many
      altitudes, so that a polygon reaches the altitudes that its roofs reach; ``[N]`` whether the height is guessed;
      ``[N]`` the number of the group.
    """
    # A number for each kind of roof: by how many altitudes it reaches, whether it is guessed, and its group.
    grid = maps.grid
    roof_m = np.nan_to_num(maps.m("roof"))
    is_guessed = np.asarray(maps.ds.get("roof_guessed", 0)) == 1
    level = np.digitize(roof_m, maps.altitudes_m)
    num_groups = len(GROUP_COLOURS)
    kind = (2 * level + is_guessed) * num_groups + group_numbers(maps)

    # Polygons around cells of a kind.
    # In cells from the southwest corner.
    traced = list(shapes(kind.astype(np.int16), mask=roof_m > 0))
    polygons = np.array([shapely.geometry.shape(shape) for shape, _ in traced], dtype=object)
    polygons = shapely.transform(
        polygons, lambda cells: grid.bounds_m[:2] + grid.resolution_m * cells
    )
    polygon_kind = np.array([number for _, number in traced], dtype=int)

    # The highest roof of each kind.
    highest_m = np.zeros(2 * num_groups * (len(maps.altitudes_m) + 1))
    np.maximum.at(highest_m, kind, roof_m)
    polygon_level, polygon_group = np.divmod(polygon_kind, num_groups)
    return polygons, highest_m[polygon_kind], polygon_level % 2 == 1, polygon_group
