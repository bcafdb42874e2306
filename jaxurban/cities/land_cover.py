"""Water and parks of OpenStreetMap files, which the strata of a study need beside the maps."""

from pathlib import Path
from typing import Any

import numpy as np
import osmium
import shapely
from osmium.filter import TagFilter

from jaxurban.cities.osm import TO_WKB, open_osm
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
    areas = TagFilter(*WATER, *PARK)
    item: Any
    for item in open_osm(path).with_areas(areas).with_filter(TagFilter(*WATER, *PARK, COAST)):
        if item.is_area() and item.num_rings()[0] and has_tag(item, WATER + PARK):
            kind = "water" if has_tag(item, WATER) else "park"
            rows.append((kind, item.tags.get("name") or "", TO_WKB.create_multipolygon(item)))
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

    faces = _faces(coast, box)
    start, end = _segments(coast)
    wet_m, dry_m = _shores_m(faces, start, end)
    if not (wet_m.any() or dry_m.any()):
        return box if _is_at_sea(box.centroid, start, end) else shapely.Polygon()
    if (np.minimum(wet_m, dry_m) > MIXED * np.maximum(wet_m, dry_m)).any():
        warn(
            "the coast lines have a gap: what lies beside it is taken for what most of its shore says, land or sea; "
            "fetch an extract with complete ways, or name another file in [study] land_cover"
        )
    return shapely.union_all(faces[wet_m > dry_m])


def _faces(coast: np.ndarray, box: shapely.Polygon) -> np.ndarray:
    """Return the polygons into which coast lines cut a box, led on to its border where they nearly reach it."""
    whole = shapely.get_parts(shapely.line_merge(shapely.union_all(coast), directed=True))
    ends = shapely.get_parts(shapely.boundary(whole))  # rings have none
    is_near = shapely.distance(box.exterior, ends) < GAP_M
    near = ends[shapely.contains_properly(box, ends) & is_near]
    bridges = shapely.shortest_line(near, box.exterior)
    # With the box's border, so that `polygonize` sees one network.
    network = shapely.union_all([*shapely.intersection(whole, box), *bridges, box.exterior])
    faces = shapely.get_parts(shapely.polygonize([network]))
    return faces[shapely.contains(box, shapely.point_on_surface(faces))]


def _segments(coast: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends, ``[N, 2]`` each, of the straight segments of coast lines that have a length."""
    points, line = shapely.get_coordinates(coast, return_index=True)
    first = np.flatnonzero(line[:-1] == line[1:])
    start, end = points[first], points[first + 1]
    has_length = (start != end).any(axis=1)
    return start[has_length], end[has_length]


def _to_the_right(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` the direction to the right of each segment, the water's side, of length 1."""
    east, north = (end - start).T
    return np.column_stack([north, -east]) / np.hypot(east, north)[:, None]


def _shores_m(
    faces: np.ndarray, start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much shore ``F`` faces have on its water's side, and on its land's side, ``[F]`` each, in metres.

    A segment counts for the face that lies half a metre beside its middle.
    """
    tree = shapely.STRtree(faces)
    length_m = np.hypot(*(end - start).T)

    def shore_m(away_m: float) -> np.ndarray:
        """Return the length of the segments that have each face so far to their right."""
        beside = shapely.points((start + end) / 2 + away_m * _to_the_right(start, end))
        segment, face = tree.query(beside, predicate="within")
        return np.bincount(face, length_m[segment], len(faces))

    return shore_m(0.5), shore_m(-0.5)


def _is_at_sea(place: shapely.Point, start: np.ndarray, end: np.ndarray) -> bool:
    """Return whether a place lies to the right of the nearest segment of a coast."""
    lines = shapely.linestrings(np.stack([start, end], axis=1))
    nearest = np.argmin(shapely.distance(lines, place))
    from_shore = shapely.get_coordinates(place)[0] - start[nearest]
    return bool(_to_the_right(start, end)[nearest] @ from_shore > 0)
