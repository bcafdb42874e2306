"""Water and parks from OpenStreetMap files: what the strata of a study need beside the maps."""

import warnings
from pathlib import Path

import numpy as np
import osmium
import shapely
from numpy.lib.stride_tricks import sliding_window_view
from osmium.filter import TagFilter

from jaxurban.errors import readable
from jaxurban.io.read.osm import open_osm
from jaxurban.world.city import LandCover
from jaxurban.world.grid import WGS84, Bounds, transformer

WATER = (("natural", "water"), ("waterway", "riverbank"), ("waterway", "dock"), ("landuse", "reservoir"))
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
      path: ``.osm.pbf`` or ``.osm``.
      crs: projected CRS of the result, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box in that CRS.

    Raises:
      InputError: the file cannot be read to its end.
    """
    water: list[str] = []  # WKB in hexadecimal
    parks: list[str] = []
    coast: list[shapely.LineString] = []
    to_wkb = osmium.geom.WKBFactory()
    remedy = "fetch it again, or name another file in [study] land_cover"
    with readable(path, "OpenStreetMap data", remedy, RuntimeError):
        areas = TagFilter(*WATER, *PARK)
        for item in open_osm(path).with_areas(areas).with_filter(TagFilter(*WATER, *PARK, COAST)):
            if isinstance(item, osmium.osm.Area) and item.num_rings()[0] and _has(item, WATER + PARK):
                (water if _has(item, WATER) else parks).append(to_wkb.create_multipolygon(item))
            elif isinstance(item, osmium.osm.Way) and _has(item, (COAST,)):
                coast += _runs(item)
    box = shapely.box(*bounds_m)
    project = transformer(WGS84, crs)

    def projected(shapes: list) -> np.ndarray:
        array = np.array(shapes, object)
        return shapely.transform(array, lambda points: np.column_stack(project.transform(*points.T)))

    def joined(shapes: list) -> shapely.Geometry:
        polygons = shapely.make_valid(projected([shapely.from_wkb(shape) for shape in shapes]))
        return shapely.intersection(shapely.union_all(polygons), box)

    return LandCover(water=shapely.union(joined(water), sea(list(projected(coast)), box)), park=joined(parks))


def _has(item: osmium.osm.OSMObject, tags: tuple[tuple[str, str], ...]) -> bool:
    return any(item.tags.get(key) == value for key, value in tags)


def _runs(way: osmium.osm.Way) -> list[shapely.LineString]:
    """Return the segments of a way between nodes that the file lacks."""
    runs: list[list[tuple[float, float]]] = [[]]
    for node in way.nodes:
        if node.location.valid():
            runs[-1].append((node.lon, node.lat))
        else:
            runs.append([])
    return [shapely.LineString(points) for points in runs if len(points) > 1]


def sea(coast: list[shapely.LineString], box: shapely.Polygon) -> shapely.Geometry:
    """Return the part of a box on the right of coast lines, which have the land on their left.

    Lines that end inside the box, no farther than `GAP_M` from its border, are led on to it: extracts are cut so. A box
    that no line parts is wet or dry by the side of the nearest line. Warns where the lines have a gap, so that land and
    sea cannot be told apart.
    """
    if not coast:
        return shapely.Polygon()
    whole = shapely.get_parts(shapely.line_merge(shapely.union_all(coast), directed=True))
    ends = shapely.get_parts(shapely.boundary(whole))  # rings have none
    near = ends[shapely.contains_properly(box, ends) & (shapely.distance(box.exterior, ends) < GAP_M)]
    bridges = shapely.shortest_line(near, box.exterior)
    # Into the box's border too, so that polygonize sees one network.
    network = shapely.union_all([*shapely.intersection(whole, box), *bridges, box.exterior])
    faces = shapely.get_parts(shapely.polygonize([network]))
    faces = faces[shapely.contains(box, shapely.point_on_surface(faces))]
    segments = np.concatenate([sliding_window_view(shapely.get_coordinates(line), 2, axis=0) for line in coast])
    segments = segments[(segments[..., 0] != segments[..., 1]).any(axis=1)]  # [N, 2 (x, y), 2 (from, to)]
    start, end = segments[..., 0], segments[..., 1]
    length_m = np.hypot(*(end - start).T)
    right = (end - start)[:, ::-1] * [1, -1] / length_m[:, None]
    tree = shapely.STRtree(faces)
    shore_m = np.zeros((2, len(faces)))  # how much of each face's shore has it on the right, and on the left
    for row, side in enumerate((1.0, -1.0)):  # half a metre into the water, and into the land
        point, face = tree.query(shapely.points((start + end) / 2 + 0.5 * side * right), predicate="within")
        np.add.at(shore_m[row], face, length_m[point])
    wet_m, dry_m = shore_m
    if not shore_m.any():
        middle = np.array(shapely.get_coordinates(box.centroid)[0])
        nearest = int(np.argmin(shapely.distance(shapely.linestrings(np.stack([start, end], axis=1)), box.centroid)))
        return box if right[nearest] @ (middle - start[nearest]) > 0 else shapely.Polygon()
    if (np.minimum(wet_m, dry_m) > MIXED * np.maximum(wet_m, dry_m)).any():
        warnings.warn(
            "the coast lines have a gap: what lies beside it is taken for what most of its shore says, land or sea; "
            "fetch an extract with complete ways, or name another file in [study] land_cover",
            stacklevel=2,
        )
    return shapely.union_all(faces[wet_m > dry_m])
