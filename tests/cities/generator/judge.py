"""The truth of a straight flight over a city, by points along it, and whether OGR and shapely see what was planted."""

import struct
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import geopandas as gpd
import numpy as np
import pyogrio
import pyproj
import shapely
from pyogrio.errors import DataSourceError, GeometryError

from tests.cities.generator.plant import Prism, Thing
from tests.cities.generator.write import CORNER_M, CRS, LONLAT, MULTIPOLYGON_Z, POLYHEDRAL_Z

STEP_M = 0.25
SURE_M = 0.15, 0.5  # so deep a contact is one, in plan and in height, whatever files round
FREE_M = 1.0  # so far from all, and what it asks for, a flight is free
APART_M = 3.0  # a finding is no farther from a place where something may be
COVERED = 0.98  # of an outline, by what OGR reads


class Truth(NamedTuple):
    """What a flight meets.

    Attributes:
      hits: the numbers of things that it surely meets, or comes nearer to than it asks for.
      known: those of them whose height and place the file says.
      is_free: nothing is so near, whatever may be taken to stand.
      near_m: ``[N, 2]`` places where something may be so near.
    """

    hits: tuple[int, ...]
    known: tuple[int, ...]
    is_free: bool
    near_m: np.ndarray


def points_along(ends_m: np.ndarray) -> np.ndarray:
    """Return ``[N, 3]`` points of a straight flight, and of the climb before it."""
    ends_m = np.concatenate([ends_m[:1] * (1, 1, 0), ends_m])
    parts = []
    for begin_m, end_m in pairwise(ends_m):
        num = max(2, int(np.linalg.norm(end_m - begin_m) / STEP_M))
        parts.append(begin_m + np.linspace(0, 1, num)[:, None] * (end_m - begin_m))
    return np.concatenate(parts)


def margins_m(
    points_m: np.ndarray, prism: Prism, clearance_m: float, vertical_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much farther than asked points are from a prism, in plan and in height, ``[N]`` each."""
    dots = shapely.points(points_m[:, :2])
    outside_m = shapely.distance(dots, prism.outline)
    inside_m = shapely.distance(dots, shapely.boundary(prism.outline))
    apart_m = np.where(outside_m > 0, outside_m, -inside_m)
    z_m = points_m[:, 2]
    return apart_m - clearance_m, np.maximum(z_m - prism.top_m, prism.floor_m - z_m) - vertical_m


def truth_of(
    things: Sequence[Thing], ends_m: np.ndarray, clearance_m: float, vertical_m: float
) -> Truth:
    """Return the truth of a flight, with the clearances beside and over things that it asks for."""
    points_m = points_along(ends_m)
    line = shapely.LineString(ends_m[:, :2])
    hits, known = [], []
    is_near = np.zeros(len(points_m), bool)
    for number, thing in enumerate(things):
        is_hit = False
        for prism in thing.core:
            plan_m, height_m = margins_m(points_m, prism, clearance_m, vertical_m)
            is_hit |= bool(((plan_m < -SURE_M[0]) & (height_m < -SURE_M[1])).any())
        for prism in thing.hull:
            if line.distance(prism.outline) <= clearance_m + FREE_M:
                plan_m, height_m = margins_m(points_m, prism, clearance_m, vertical_m)
                is_near |= (plan_m <= FREE_M) & (height_m <= FREE_M)
        if is_hit:
            hits.append(number)
            known += [number] * thing.is_known
    return Truth(tuple(hits), tuple(known), not is_near.any(), points_m[is_near, :2])


def invented(truth: Truth, places_m: np.ndarray) -> int:
    """Return how many findings at ``[K, 2]`` places are where nothing may be."""
    if not len(places_m):
        return 0
    if not len(truth.near_m):
        return len(places_m)
    apart_m = np.linalg.norm(places_m[:, None] - truth.near_m, axis=-1).min(axis=1)
    return int((apart_m > APART_M).sum())


def seen_by_ogr(file: Path) -> np.ndarray:
    """Return the geometries of all layers of a file by OGR, in metres of the city; none if it cannot read them."""
    if file.suffix == ".parquet":  # by Arrow, as few builds of GDAL read it
        shapes = gpd.read_parquet(file).to_crs(CRS).geometry.to_numpy()
        return shapely.transform(shapely.force_2d(shapes), lambda places: places - CORNER_M)
    shapes = []
    # The index of its own knows no ids below 0; a large file in memory takes longer than all else.
    pyogrio.set_gdal_config_options({"OSM_USE_CUSTOM_INDEXING": "NO", "OSM_MAX_TMPFILE_SIZE": "1"})
    try:
        for layer, _ in pyogrio.list_layers(file):
            facts, _, blobs, _ = pyogrio.raw.read(file, layer=layer)
            if blobs is None:
                continue
            plain = [_as_multipolygon(blob) for blob in blobs if blob is not None]
            moved = shapely.from_wkb(np.array(plain, object))
            to = pyproj.Transformer.from_crs(facts["crs"] or LONLAT, CRS, always_xy=True)
            moved = shapely.transform(shapely.force_2d(moved), to.transform, interleaved=False)
            shapes.append(shapely.transform(moved, lambda places: places - CORNER_M))
    except (DataSourceError, GeometryError):
        return np.array([], object)
    return np.concatenate(shapes)


def _as_multipolygon(blob: bytes) -> bytes:
    """Return WKB, of a polyhedral surface as that of its faces."""
    head = struct.pack("<BI", 1, POLYHEDRAL_Z)
    return struct.pack("<BI", 1, MULTIPOLYGON_Z) + blob[5:] if blob[:5] == head else blob


def confirmed(things: Sequence[Thing], shapes: np.ndarray) -> list[bool]:
    """Return of each thing whether all its entries are among the shapes that OGR reads of the file."""
    # The faces of a shape one by one, as walls that stand upright have no area in plan.
    faces = shapely.get_parts(shapely.get_parts(shapely.get_parts(shapes)))
    # Of closed ways with tags that it does not know as those of areas OGR makes lines.
    rings = [shapely.Polygon(line.coords) for line in faces[shapely.is_closed(faces)]]
    faces = np.array([*faces[~shapely.is_closed(faces)], *rings], object)
    faces = faces[shapely.is_valid(faces) & ~shapely.is_empty(faces)]
    tree = shapely.STRtree(faces)

    def is_seen(shape: shapely.Geometry) -> bool:
        flat = shapely.force_2d(shape)
        near = faces[tree.query(flat, predicate="dwithin", distance=0.1)]
        if flat.geom_type in ("Point", "LineString"):
            return bool((shapely.hausdorff_distance(near, flat) < 0.1).any())
        parts = shapely.get_parts(flat)
        outline = shapely.union_all(parts[shapely.is_valid(parts)])
        seen = shapely.union_all(near[shapely.get_dimensions(near) == 2])
        is_part = shapely.area(seen & outline) >= COVERED * outline.area
        return bool(is_part and any(shapely.area(near) <= outline.area / COVERED))

    return [all(is_seen(record.shape) for record in thing.records) for thing in things]
