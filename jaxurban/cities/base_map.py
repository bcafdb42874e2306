"""The base map: streets, rails, water, parks and names of places, which pictures show below maps to orient in.

Nothing is computed from it. It is read from OpenStreetMap files, and from GeoParquet files that were written of it.
"""

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import osmium
import pandas as pd
import shapely
from osmium.filter import KeyFilter

from jaxurban.cities.land_cover import areas_and_coast, projected, read_land_cover, runs_of, sea
from jaxurban.cities.osm import OSM_CREDIT, TO_WKB, is_osm, open_osm
from jaxurban.cities.osm_plain import plain_osm
from jaxurban.errors import readable
from jaxurban.io.geoparquet import read_geoparquet
from jaxurban.io.samples import BASE_MAP_FILE, is_sample, located
from jaxurban.world.grid import WGS84, Bounds
from jaxurban.world.land_cover import LandCover

# In the order in which they are drawn.
KINDS = ("water", "park", "path", "street", "major", "rail", "place")
_CLASSES = {
    "major": "motorway trunk primary secondary",
    "street": "tertiary unclassified residential living_street pedestrian road",
    "path": "service footway path cycleway steps track bridleway",
}
# Of the tag `highway`; "_link" counts as what it links.
CLASSES = {value: kind for kind, values in _CLASSES.items() for value in values.split()}
# Of `footway` and `service`.
BESIDE_STREETS = ("sidewalk", "crossing", "parking_aisle", "driveway", "drive-through")
RAILS = ("rail", "light_rail", "subway", "tram", "narrow_gauge", "monorail", "funicular")
PLACES = (
    "city",
    "borough",
    "town",
    "suburb",
    "quarter",
    "neighbourhood",
    "village",
    "hamlet",
    "island",
    "islet",
    "square",
)
OF_LINES_AND_PLACES = KeyFilter("highway", "railway", "place")
TOLERANCE_M = 1.0  # lines are simplified to it
LEAST_M2 = 50.0  # smaller waters and parks are left out
STEP_DEG = 1e-6  # of coordinates, about 0.1 m
LICENCE = "ODbL-1.0"


def base_map_source(source: str | Path | None) -> Path | None:
    """Return the file that has the base map of a source of buildings, None where nothing has one.

    A sample city has a file beside its buildings; files of OpenStreetMap and of base maps are such a file themselves.
    """
    if source is None:
        return None
    if is_sample(source):
        path = located(source).with_name(BASE_MAP_FILE)
        return path if path.is_file() else None
    is_base = str(source).lower().endswith(BASE_MAP_FILE) or is_osm(source)
    return Path(source) if is_base else None


def read_base_map(path: str | Path, crs: str, bounds_m: Bounds) -> gpd.GeoDataFrame:
    """Return what a file has of a base map within a box.

    Streets and rails in tunnels are left out, and so are sidewalks, crossings and ways on parking grounds. Lines of one
    kind and name are one feature.

    Args:
      path: ``.osm.pbf``, ``.osm``, or a GeoParquet file of one that maps wrote.
      crs: projected CRS of the box, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box.

    Returns:
      Features in EPSG:4326 with ``kind`` (one of `KINDS`, in this order) and ``name`` (empty without one): polygons of
      water and parks, lines, points of places. ``attrs`` hold ``credit`` and ``licence``.

    Warns:
      UserWarning: the lines of a coast have a gap (see `jaxurban.cities.land_cover.sea`).

    Raises:
      InputError: the file cannot be read.
    """
    if is_osm(path):
        frame = _from_osm(path, crs, bounds_m)
        frame.attrs = {"credit": OSM_CREDIT, "licence": LICENCE}
    else:
        with readable(path, "a base map", "make the maps again, which writes it"):
            frame = read_geoparquet(path)[["kind", "name", "geometry"]].to_crs(crs)
    # Points outside would not be cut away.
    frame = frame[(frame["kind"] != "place") | frame.intersects(shapely.box(*bounds_m))]
    frame = frame.set_geometry(frame.clip_by_rect(*bounds_m))
    frame = frame[~frame.is_empty].to_crs(WGS84)
    rounded = frame.geometry.transform(lambda points: np.round(points / STEP_DEG) * STEP_DEG)
    return frame.set_geometry(rounded)


def land_cover_from(source: str | Path, crs: str, bounds_m: Bounds) -> LandCover | None:
    """Return the water and the parks within a box of a sample city or an OSM file; None of what holds neither.

    Args:
      source: ``"sample:CITY"`` or a file.
      crs, bounds_m: as of `read_base_map`.

    Raises:
      InputError: the file cannot be read.
    """
    if not is_sample(source):
        return read_land_cover(source, crs, bounds_m) if is_osm(source) else None
    path = base_map_source(source)
    if path is None:
        return None
    frame = read_base_map(path, crs, bounds_m).to_crs(crs)
    shapes = frame.make_valid()
    return LandCover(*(shapes[frame["kind"] == kind].union_all() for kind in ("water", "park")))


def _from_osm(path: str | Path, crs: str, bounds_m: Bounds) -> gpd.GeoDataFrame:
    """Return the features of an OSM file near a box, simplified, those of one kind and name as one.

    Args:
      path: of the file.
      crs: projected CRS of the box and the result, metres.
      bounds_m: x_min, y_min, x_max, y_max of the box; features that touch it are returned whole.

    Returns:
      ``kind``, ``name`` and ``geometry``, in the order of `KINDS`. Areas smaller than `LEAST_M2` are empty.

    Raises:
      InputError: the file cannot be read.
    """
    with plain_osm(path, "fetch it again") as plain:
        rows, coast = areas_and_coast(plain)
        for item in open_osm(plain).with_filter(OF_LINES_AND_PLACES):
            rows += _rows_of(item)

    # The features near the box and the sea, joined by kind and name.
    table = pd.DataFrame(rows, columns=["kind", "name", "shape"])
    shapes = projected(shapely.from_wkb(table.pop("shape").to_numpy(object)), crs)
    box = shapely.box(*bounds_m)
    frame = gpd.GeoDataFrame(table, geometry=shapes, crs=crs)
    frame = frame[frame.intersects(box)]
    wet = sea(projected(coast, crs), box)
    if not wet.is_empty:
        frame.loc[len(rows)] = ["water", "", wet]
    frame = frame.dissolve(["kind", "name"], as_index=False)[["kind", "name", "geometry"]]
    shapes = _simplified(frame.geometry.to_numpy().copy(), frame["kind"].to_numpy())
    order = np.argsort(list(map(KINDS.index, frame["kind"])), kind="stable")
    return frame.set_geometry(shapes, crs=crs).iloc[order].reset_index(drop=True)


def _rows_of(item: Any) -> list[tuple[str, str, str]]:
    """Return kind, name and WKB in hexadecimal of the lines of a street or a rail, or of a place that has a name."""
    kind = _kind_of(item)
    name = item.tags.get("name") or ""
    if kind == "place":
        return [(kind, name, TO_WKB.create_point(item))] if item.is_node() and name else []
    if not kind or not item.is_way():
        return []
    return [(kind, name, line.wkb_hex) for line in runs_of(item)]


def _simplified(shapes: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """Return valid areas, empty where they are smaller than `LEAST_M2`, and lines in one piece, simplified.

    Args:
      shapes: ``[N]`` of areas, lines and points in a CRS in metres; changed in place.
      kind: ``[N]`` of `KINDS`.
    """
    is_area = np.isin(kind, ("water", "park"))
    is_line = ~is_area & (kind != "place")
    shapes[is_area] = shapely.make_valid(shapes[is_area])
    shapes[is_line] = shapely.line_merge(shapes[is_line])
    simple = shapely.simplify(shapes, TOLERANCE_M)
    simple[is_area & (shapely.area(simple) < LEAST_M2)] = shapely.Polygon()
    return simple


def _kind_of(item: osmium.osm.OSMObject) -> str:
    """Return the kind of a street, a rail or a place by its tags, one of `KINDS`; empty for what is left out.

    Left out are tunnels, areas, tracks beside a railway's own, ways beside streets and on parking grounds, and classes
    that `CLASSES` lacks.
    """
    tags = item.tags
    if tags.get("place") in PLACES:
        return "place"
    if tags.get("tunnel", "no") not in ("no", "building_passage") or tags.get("area") == "yes":
        return ""
    if tags.get("railway") in RAILS:
        return "" if "service" in tags else "rail"
    if tags.get("footway") in BESIDE_STREETS or tags.get("service") in BESIDE_STREETS:
        return ""
    return CLASSES.get((tags.get("highway") or "").removesuffix("_link"), "")
