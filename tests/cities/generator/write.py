"""Files of random cities: OpenStreetMap's XML, GeoJSON, GeoPackage, Shapefile and GeoParquet, in several styles."""

import json
import sqlite3
import struct
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pyproj
import shapely

from tests.cities.generator.plant import SIDE_M, Record, Tags

CRS, CORNER_M = "EPSG:32618", (583_000.0, 4_506_000.0)  # in Lower Manhattan
FEET_CRS, FOOT_M = "EPSG:2263", 0.3048  # US survey feet
LONLAT = "EPSG:4326"
BASE_M = 5.0  # elevation of the ground in columns of levels above the sea
MULTIPOLYGON_Z, POLYHEDRAL_Z = 1006, 1015  # in WKB
TO_LONLAT = pyproj.Transformer.from_crs(CRS, LONLAT, always_xy=True)
BOUNDS = (
    *TO_LONLAT.transform(*CORNER_M),
    *TO_LONLAT.transform(CORNER_M[0] + SIDE_M, CORNER_M[1] + SIDE_M),
)
SIMPLE = (".geojson", ".gpkg", ".parquet")
TABLES = (*SIMPLE, ".shp")


def feet(tags: Tags, name: str) -> Tags:
    """Return the one column of heights in feet."""
    return {name: round(tags["height"] / FOOT_M, 2)} if tags else {name: None}


def levels(tags: Tags, low: str, high: str, **others: float) -> Tags:
    """Return columns of two levels above the sea, and of others between them as shares of the height."""
    if not tags:
        return {low: BASE_M, high: None}
    between = {name: BASE_M + share * tags["height"] for name, share in others.items()}
    return {low: BASE_M, high: BASE_M + tags["height"]} | between


def overture(tags: Tags) -> Tags:
    """Return the columns of Overture Maps."""
    names = ("id", "height", "num_floors", "building_id")
    flags = {"type": "building", "is_underground": False, "has_parts": False}
    return dict.fromkeys(names) | flags | tags


def hstore(tags: Tags) -> Tags:
    """Return the columns of GDAL's driver of OpenStreetMap, which keeps most tags in one."""
    own = {name: tags.get(name) for name in ("building", "man_made", "type")}
    others = [f'"{name}"=>"{value}"' for name, value in tags.items() if name not in own]
    return own | {"other_tags": ",".join(others) or None}


class Style(NamedTuple):
    """How a file says what it says: formats, what it offers to edits, its plain thing, columns of tags, and CRS."""

    formats: tuple[str, ...]
    offers: frozenset[str]
    plain: str
    columns: Callable[[Tags], Tags] = dict
    crs: tuple[str, ...] = (CRS, LONLAT)


def column_style(columns: Callable[[Tags], Tags], *crs: str) -> Style:
    """Return the style of official footprints."""
    return Style(TABLES, frozenset({"column"}), "column", columns, crs or (CRS, LONLAT))


_TAGS, _LONG = frozenset({"tags"}), frozenset({"tags", "points", "long names"})
STYLES = {
    "osm": Style((".osm",), _LONG | {"xml"}, "plain"),
    "out geom": Style((".osm",), _LONG, "plain"),
    "tags": Style(SIMPLE, _LONG, "plain"),
    "tags, ten letters": Style((".shp",), _TAGS, "plain"),
    "nested tags": Style((".geojson",), _LONG, "plain", lambda tags: {"type": "way", "tags": tags}),
    "other_tags": Style(SIMPLE, _LONG, "plain", hstore),
    # Not in Shapefiles, whose faces would be rings of one area.
    "faces": Style(SIMPLE, frozenset({"faces"}), "block"),
    "faces alone": Style(
        SIMPLE, frozenset({"faces"}), "block", lambda tags: {"gml_id": "DEBW_0010001"}
    ),
    "polyhedral": Style((".gpkg",), frozenset({"faces"}), "block", crs=(CRS,)),
    "overture": Style(SIMPLE, {"overture"}, "overture plain", overture),
    "heightroof": column_style(lambda tags: feet(tags, "heightroof") | {"groundelev": 9.0}),
    "HEIGHT in feet": column_style(lambda tags: feet(tags, "HEIGHT"), FEET_CRS),
    "TopHeight": column_style(lambda tags: levels(tags, "BaseHeight", "TopHeight")),
    "b3_h_dak_max": column_style(
        lambda tags: levels(tags, "b3_h_maaiveld", "b3_h_dak_max", b3_h_dak_50p=0.7)
    ),
    "HAUTEUR": column_style(lambda tags: {"HAUTEUR": tags.get("height"), "NB_ETAGES": None}),
}


def placed(shape: Any, crs: str = LONLAT) -> Any:
    """Return shapes in a CRS."""
    to = pyproj.Transformer.from_crs(CRS, crs, always_xy=True).transform

    def move(x_m: np.ndarray, y_m: np.ndarray, *z_m: np.ndarray) -> tuple[np.ndarray, ...]:
        return (*to(x_m + CORNER_M[0], y_m + CORNER_M[1]), *z_m)

    flat = shapely.transform(shape, move, interleaved=False, include_z=False)
    if not np.any(shapely.has_z(shape)):
        return flat
    return shapely.transform(shape, move, interleaved=False, include_z=True)


def write(records: Sequence[Record], file: Path, style: str, rng: np.random.Generator) -> None:
    """Write the file of a city."""
    if file.suffix == ".osm":
        file.write_text(osm_text(records, style))
        return
    about = STYLES[style]
    rows = [about.columns(record.tags) for record in records]
    shapes = [record.shape for record in records]
    if file.suffix == ".geojson":
        write_geojson(file, rows, shapes)
        return
    crs = str(rng.choice(about.crs))
    if style == "polyhedral":
        write_polyhedral(file, rows, shapes, crs, bool(rng.integers(2)))
        return
    frame = gpd.GeoDataFrame(pd.DataFrame(rows), geometry=list(placed(shapes, crs)), crs=crs)
    if file.suffix == ".parquet":
        frame.to_parquet(file)
    elif style == "other_tags":  # as `ogr2ogr` makes it of OpenStreetMap
        dimension = shapely.get_dimensions(frame.geometry.to_numpy())
        for number, layer in enumerate(("points", "lines", "multipolygons")):
            if (dimension == number).any():
                frame[dimension == number].to_file(file, layer=layer)
    else:
        frame.to_file(file)


def write_geojson(file: Path, rows: Sequence[Tags], shapes: Sequence[shapely.Geometry]) -> None:
    """Write GeoJSON, whose properties may hold others."""
    features = [
        {"type": "Feature", "properties": row, "geometry": shapely.geometry.mapping(shape)}
        for row, shape in zip(rows, placed(shapes), strict=True)
    ]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def write_polyhedral(
    file: Path, rows: Sequence[Tags], shapes: Sequence[Any], crs: str, is_declared: bool
) -> None:
    """Write a GeoPackage of polyhedral surfaces: of MultiPolygons their WKB differs by its type alone."""
    blobs = []
    for blob in shapely.to_wkb(placed(shapes, crs), flavor="iso", output_dimension=3):
        assert struct.unpack("<BI", blob[:5]) == (1, MULTIPOLYGON_Z)
        blobs.append(struct.pack("<BI", 1, POLYHEDRAL_Z) + blob[5:])
    columns = pd.DataFrame(rows)
    pyogrio.raw.write(
        file,
        np.array(blobs, object),
        [columns[name].to_numpy() for name in columns],
        list(columns),
        geometry_type="Unknown",
        crs=crs,
    )
    if is_declared:
        with sqlite3.connect(file) as base:
            base.execute("UPDATE gpkg_geometry_columns SET geometry_type_name='POLYHEDRALSURFACE'")
        base.close()


def osm_text(records: Sequence[Record], style: str) -> str:
    """Return the XML of OpenStreetMap; out geom has the places in its ways, and no nodes."""
    numbers = count(1)
    nodes, ways, relations = [], [], []
    node_at: dict[tuple[float, ...], int] = {}
    has_nodes = style != "out geom"

    def tagged(kind: str, number: int, tags: Tags, inner: str = "", more: str = "") -> str:
        lines = [f"<tag k={quoteattr(k)} v={quoteattr(str(v))}/>" for k, v in tags.items()]
        return f'<{kind} id="{number}" version="1"{more}>{inner}{"".join(lines)}</{kind}>'

    def node(lon: float, lat: float, sign: int, tags: Tags, is_lost: bool = False) -> int:
        number = sign * next(numbers)
        if not is_lost:
            nodes.append(tagged("node", number, tags, more=f' lat="{lat:.7f}" lon="{lon:.7f}"'))
        return number

    def way(places: np.ndarray, tags: Tags, how: str = "", is_lost: bool = False) -> int:
        sign = -1 if how.startswith("negative") else 1
        if has_nodes:
            for at, place in enumerate(places.tolist()):
                if tuple(place) not in node_at:
                    is_gone = is_lost or (how == "missing node" and at == 3)
                    node_at[tuple(place)] = node(*place, sign, {}, is_gone)
            refs = [node_at[tuple(place)] for place in places.tolist()]
            if how == "open":
                refs.pop()
            inner = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        else:
            inner = "".join(
                f'<nd ref="{next(numbers)}" lat="{lat:.7f}" lon="{lon:.7f}"/>'
                for lon, lat in places
            )
        number = next(numbers) * (-1 if how == "negative" else 1)
        if not is_lost:
            ways.append(tagged("way", number, tags, inner))
        return number

    for shape, tags, how in records:
        moved = placed(shape)
        places = shapely.get_coordinates(moved)
        if shape.geom_type == "Point":
            node(*places[0], 1, tags)
        elif how in ("relation", "halves", "missing member"):
            halves = [places] if how == "relation" else [places[:3], places[2:]]
            role = "outline" if how == "relation" else "outer"
            lost = (False, how == "missing member")
            refs = [way(half, {}, is_lost=gone) for half, gone in zip(halves, lost, strict=False)]
            inner = "".join(f'<member type="way" ref="{ref}" role="{role}"/>' for ref in refs)
            relations.append(tagged("relation", next(numbers), tags, inner))
        else:
            way(places, tags, how)
    west, south, east, north = BOUNDS
    box = f'<bounds minlat="{south}" minlon="{west}" maxlat="{north}" maxlon="{east}"/>'
    lines = ['<?xml version="1.0" encoding="UTF-8"?><osm version="0.6">', box]
    return "\n".join([*lines, *nodes, *ways, *relations, "</osm>"])
