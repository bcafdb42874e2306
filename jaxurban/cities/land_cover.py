"""Water and parks of OpenStreetMap files, which the strata of a study need beside the maps."""

from pathlib import Path
from typing import Any

import numpy as np
import osmium
import shapely
from osmium.filter import TagFilter

from jaxurban.cities.osm import open_osm
from jaxurban.cities.osm_plain import plain_osm
from jaxurban.errors import warn
from jaxurban.world.grid import WGS84, Bounds, transformer
from jaxurban.world.land_cover import LandCover

WATER = (
    ("natural", "water"),
    ("waterway", "riverbank"),
    ("waterway", "dock"),
    ("landuse", "reservoir"),
)
PARK = (
    *(("leisure", value) for value in ("park", "nature_reserve", "golf_course")),
    *(("landuse", value) for value in ("cemetery", "forest", "recreation_ground")),
)
COAST = ("natural", "coastline")
MIXED = 0.2  # share of the shore on a face's other side, above which land and sea were not parted
GAP_M = 500.0  # a coast that ends nearer than this to the region's border was cut there


def read_land_cover(path: str | Path, crs: str, bounds_m: Bounds) -> LandCover:
    """Return the water and the parks of an OSM file within a box.

    Water is what is tagged so, and the sea: OSM draws its coast as lines with the land on their left, which are joined
    and cut out of the box here. Parks are parks, nature reserves, golf courses, cemeteries, forests and recreation
    grounds. Areas that cannot be assembled are left out.

    Args:
      path: as of `read_osm`.
      crs: projected CRS of the result, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box in that CRS.

    Raises:
      InputError: the file cannot be read to its end.
    """
    remedy = "fetch it again, or name another file in [study] land_cover"
    with plain_osm(path, remedy) as plain:
        rows, coast = areas_and_coast(plain)
    box = shapely.box(*bounds_m)

    def joined(kind: str) -> shapely.Geometry:
        """Return all areas of a kind in the box as one, in ``crs``."""
        shapes = [shapely.from_wkb(shape) for own_kind, _, shape in rows if own_kind == kind]
        whole = shapely.union_all(shapely.make_valid(projected(shapes, crs)))
        return shapely.intersection(whole, box)

    wet = sea(projected(coast, crs), box)
    return LandCover(water=shapely.union(joined("water"), wet), park=joined("park"))


def areas_and_coast(
    path: str | Path,
) -> tuple[list[tuple[str, str, str]], list[shapely.LineString]]:
    """Return the waters and parks of an OSM file, and the lines of its coast, in longitude and latitude.

    Returns:
      A row for each area: its kind (``water`` or ``park``), its name (empty without one) and its hexadecimal WKB; and
      the runs of the coast's ways, see `runs_of`. Areas that cannot be assembled are left out.
    """
    rows: list[tuple[str, str, str]] = []
    coast = []
    to_wkb = osmium.geom.WKBFactory()
    areas = TagFilter(*WATER, *PARK)
    item: Any
    for item in open_osm(path).with_areas(areas).with_filter(TagFilter(*WATER, *PARK, COAST)):
        if item.is_area() and item.num_rings()[0] and has_tag(item, WATER + PARK):
            kind = "water" if has_tag(item, WATER) else "park"
            rows.append((kind, item.tags.get("name") or "", to_wkb.create_multipolygon(item)))
        elif item.is_way() and has_tag(item, (COAST,)):
            coast += runs_of(item)
    return rows, coast


def projected(shapes: list[shapely.Geometry], crs: str) -> np.ndarray:
    """Return shapes in longitude and latitude as an array of them in a projected CRS."""
    return shapely.transform(
        np.array(shapes, object), transformer(WGS84, crs).transform, interleaved=False
    )


def has_tag(item: osmium.osm.OSMObject, tags: tuple[tuple[str, str], ...]) -> bool:
    """Return whether an object has one of these keys with its value."""
    return any(item.tags.get(key) == value for key, value in tags)


def runs_of(way: osmium.osm.Way) -> list[shapely.LineString]:
    """Return the lines of a way in longitude and latitude: one, or several between nodes that the file lacks.

    Nodes that stand alone between missing ones are left out.
    """
    runs: list[list[tuple[float, float]]] = [[]]
    for node in way.nodes:
        if node.location.valid():
            runs[-1].append((node.lon, node.lat))
        else:
            runs.append([])
    return [shapely.LineString(points) for points in runs if len(points) > 1]


def sea(coast: np.ndarray, box: shapely.Polygon) -> shapely.Geometry:
    """Return the part of a box on the right of coast lines, which have the land on their left.

    A line that ends inside the box, less than `GAP_M` from its border, is led on to the border, as extracts are cut in
    this way. A box that no line cuts is all sea or all land, by the side of the nearest line on which its centre lies.

    Args:
      coast: array of lines in a projected CRS in metres; without any there is no sea.
      box: in the same CRS.

    Returns:
      A polygon or several; an empty polygon where there is no sea.

    Warns:
      UserWarning: the lines have a gap, so that land and sea cannot be distinguished.
    """
    if not len(coast):
        return shapely.Polygon()

    # Cut the box along the coast into faces, each of which is sea or land.
    whole = shapely.get_parts(shapely.line_merge(shapely.union_all(coast), directed=True))
    ends = shapely.get_parts(shapely.boundary(whole))  # rings have none
    is_near = shapely.distance(box.exterior, ends) < GAP_M
    near = ends[shapely.contains_properly(box, ends) & is_near]
    bridges = shapely.shortest_line(near, box.exterior)
    # With the box's border, so that `polygonize` sees one network.
    network = shapely.union_all([*shapely.intersection(whole, box), *bridges, box.exterior])
    faces = shapely.get_parts(shapely.polygonize([network]))
    faces = faces[shapely.contains(box, shapely.point_on_surface(faces))]

    # The ends [N, 2] of the coast's straight segments. Those that have a length are kept, and `right` is the direction
    # [N, 2] to their right.
    points, line = shapely.get_coordinates(coast, return_index=True)
    first = np.flatnonzero(line[:-1] == line[1:])
    start, end = points[first], points[first + 1]
    is_long = (start != end).any(axis=1)
    start = start[is_long]
    end = end[is_long]
    length_m = np.hypot(*(end - start).T)
    right = (end - start)[:, ::-1] * [1, -1] / length_m[:, None]

    # How much of each face's shore has it on its right, the water's side, and on its left, the land's: a segment counts
    # for the face that lies half a metre beside its middle.
    tree = shapely.STRtree(faces)
    shore_m = np.zeros((2, len(faces)))
    for row, side in enumerate((1.0, -1.0)):
        beside = shapely.points((start + end) / 2 + 0.5 * side * right)
        point, face = tree.query(beside, predicate="within")
        np.add.at(shore_m[row], face, length_m[point])
    wet_m, dry_m = shore_m

    # Without coast in the box, the side of the nearest segment on which the middle of the box lies.
    if not shore_m.any():
        middle = box.centroid
        lines = shapely.linestrings(np.stack([start, end], axis=1))
        nearest = np.argmin(shapely.distance(lines, middle))
        from_shore = shapely.get_coordinates(middle)[0] - start[nearest]
        return box if right[nearest] @ from_shore > 0 else shapely.Polygon()

    # A face that has much shore of both kinds shows a gap in the lines.
    if (np.minimum(wet_m, dry_m) > MIXED * np.maximum(wet_m, dry_m)).any():
        warn(
            "the coast lines have a gap: what lies beside it is taken for what most of its shore says, land or sea; "
            "fetch an extract with complete ways, or name another file in [study] land_cover"
        )
    return shapely.union_all(faces[wet_m > dry_m])
