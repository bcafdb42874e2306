"""Vector files, opened the same way for every use, and the building outlines in them."""

import json
import re
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely

from jaxurban.errors import InputError, readable
from jaxurban.io.geoparquet import facts_of
from jaxurban.io.read.issues import ReadIssue
from jaxurban.io.read.outlines import (
    Near,
    Outlines,
    extent_of,
    is_of_buildings,
    near_rows,
    polygonal,
    tags_of,
)
from jaxurban.io.read.solids import openable
from jaxurban.world.grid import check_on_earth

PARQUET_SUFFIXES = (".parquet", ".geoparquet")
INDEXED_SUFFIXES = (".gpkg", ".shp")  # whose features are found by their boxes
VECTOR_SUFFIXES = (".geojson", ".json", *INDEXED_SUFFIXES, *PARQUET_SUFFIXES)
BUILDINGS = "buildings"  # the role, and the layer of several
WHOLE = "give a whole one, with its companions"
# Raised by readers.
OF_DAMAGED = (RuntimeError, LookupError, TypeError, AttributeError, shapely.errors.ShapelyError)
# How a file of a format begins. GDAL takes any format under any name, and some of them read other files, even from a
# server: by their first bytes such are refused before GDAL sees them.
BEGINNINGS = {
    **dict.fromkeys((".geojson", ".json"), b"{"),
    **dict.fromkeys((".kml", ".gpx"), b"<"),
    **dict.fromkeys(PARQUET_SUFFIXES, b"PAR1"),
    ".gpkg": b"SQLite format 3",
    ".shp": bytes.fromhex("0000270a"),
    ".fgb": b"fgb",
}
REFERRING = (
    b"<OGRVRTDataSource",
    b"gdal_streamed_alg",
    b"<OGRWFSDataSource",
    b"<OGRElasticDataSource",
)
HEAD_BYTES = 1 << 16  # GDAL looks at fewer
ESCAPE = re.compile(rb"\\u00([2-7][0-9a-fA-F])")  # a plain letter of JSON in digits
LINK = re.compile(rb'"type"\s*:\s*"(link|url)"')  # of a CRS, by the GeoJSON of 2008
POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)


def open_frame(
    path: str | Path, role: str, *, allow_empty: bool = False, near: Near | None = None
) -> gpd.GeoDataFrame:
    """Return the features of a vector file (of a format in `BEGINNINGS`), those without geometry too.

    A ring of too few points becomes an empty geometry, and no error.

    Args:
      path: the file.
      role: what it holds, for messages; the layer of this name is taken where several hold polygons.
      allow_empty: accept a file without a single feature.
      near: a region; features of GeoPackages and Shapefiles that are not near it are left out, for buildings only.

    Raises:
      InputError: no such file, not a readable vector file, no geometry, no CRS, coordinates beyond the globe though
        the CRS is in degrees, or several layers of polygons and not one of them called ``role``.
    """
    (frame,) = _read(path, role, near=near)
    if not allow_empty and (frame.empty or frame.geometry.isna().all()):
        raise InputError(
            f"the {role} file {str(path)!r} holds no polygons: give a file of polygons"
        )
    return frame


def open_layers(path: str | Path, role: str) -> list[gpd.GeoDataFrame]:
    """Return the features of every layer of a vector file, those without geometry left out.

    Every folder of a KML file is a layer. Nothing is passed over: a ring of too few points is an error.

    Raises:
      InputError: as `open_frame`, but for several layers.
    """
    return _read(path, role, every_layer=True)


def _read(
    path: str | Path, role: str, *, every_layer: bool = False, near: Near | None = None
) -> list[gpd.GeoDataFrame]:
    """Return the features of the one layer of polygons, or of every layer, checked; see `open_frame`, `open_layers`."""
    name = f"the {role} file {str(path)!r}"
    suffix = Path(path).suffix.lower()
    with readable(path, "a vector file", WHOLE, *OF_DAMAGED, what=name):
        _check_format(Path(path))
        if suffix in PARQUET_SUFFIXES:
            frames = [_read_parquet(path, for_buildings=role == BUILDINGS)]
        else:
            source = path if every_layer else openable(path)
            options: dict[str, Any] = {"on_invalid": "ignore", "fid_as_index": True}
            if every_layer:
                options["on_invalid"] = "raise"
                layers = [layer for layer, _ in pyogrio.list_layers(source)]
            else:
                layers = [_polygon_layer(path, source, role)]
            if near is not None and suffix in INDEXED_SUFFIXES:
                options |= _only_near(source, layers[0], near)
            frames = [pyogrio.read_dataframe(source, layer=layer, **options) for layer in layers]
            # In the order of the file, also where its index gave them in another.
            frames = [frame.sort_index().reset_index(drop=True) for frame in frames]

    frames = [frame for frame in frames if isinstance(frame, gpd.GeoDataFrame)]
    if not frames:
        raise InputError(f"{name} holds no geometry: give a file of polygons")
    for frame in frames:
        _check(name, frame)
    return frames


def _read_parquet(path: str | Path, *, for_buildings: bool) -> gpd.GeoDataFrame:
    """Return the features of a GeoParquet file, with the facts of its metadata as ``attrs``.

    With ``for_buildings`` only geometries and the columns that describe buildings (`is_of_buildings`) are read.
    """
    import pyarrow.parquet as pq  # imported here: it takes 0.1 s to load, for which other formats need not wait

    schema = pq.read_schema(path)
    shapes = json.loads((schema.metadata or {}).get(b"geo", b"{}")).get("columns", {})
    columns = [
        name
        for name in schema.names
        if name in shapes or not for_buildings or is_of_buildings(name)
    ]
    frame = gpd.read_parquet(path, columns=columns)
    frame.attrs = facts_of(schema.metadata)
    index = [name for name in frame.index.names if name is not None and name not in frame.columns]
    return frame.reset_index(level=index)  # pandas wrote it as an index


def _check_format(path: Path) -> None:
    """Check that a file begins as the format of its suffix does, and that it refers to no other file or server.

    A file whose suffix is not in `BEGINNINGS` may be of any of these formats.

    Raises:
      InputError: a folder, or a file of such another suffix and of none of the formats.
      ValueError: it does not begin as its suffix says, or refers to others.
    """
    suffix = path.suffix.lower()
    beginnings = tuple(BEGINNINGS.values())
    if suffix in BEGINNINGS:
        beginnings = (BEGINNINGS[suffix],)
    other = InputError(
        f"{str(path)!r} is of a format that is not read: unpack it, or make a GeoPackage of it with `ogr2ogr`"
    )
    if path.is_dir():
        raise other
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()  # without the mark of UTF-8
    if not text.startswith(beginnings):
        if suffix not in BEGINNINGS:
            raise other
        raise ValueError(f"it does not begin as a {suffix} file does")
    may_be_json = beginnings[0] == b"{"
    if any(word in head for word in REFERRING) or (may_be_json and _links_crs(path.read_bytes())):
        raise ValueError("it refers to other files or servers, which are never opened")


def _links_crs(text: bytes) -> bool:
    """Return whether a ``crs`` in a text of JSON may be a link, which GDAL would follow to a server."""
    plain = ESCAPE.sub(lambda match: bytes.fromhex(match[1].decode()), text).lower()
    return b'"crs"' in plain and LINK.search(plain) is not None


def _check(name: str, frame: gpd.GeoDataFrame) -> None:
    """Make text of what a frame's columns hold beside numbers and text, and check its place on the Earth.

    Args:
      name: of the file, for messages.
      frame: changed in place.

    Raises:
      InputError: no CRS, one that is no place on the Earth, or coordinates beyond the globe though it is in degrees.
    """
    for column in frame.columns.difference([frame.geometry.name]):
        if pd.api.types.is_object_dtype(frame[column]):
            frame[column] = frame[column].map(_scalar)
    if frame.crs is None:
        raise InputError(
            f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN` "
            "(a Shapefile has it in its .prj)"
        )
    check_on_earth(name, frame.crs.to_wkt(), frame.total_bounds)
    x_min, y_min, x_max, y_max = frame.total_bounds
    if frame.crs.is_geographic and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
        raise InputError(
            f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the "
            "CRS that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` "
            "(GeoJSON is always in longitude and latitude)"
        )


def _only_near(source: str | Path | bytes, layer: str, near: Near) -> dict[str, Any]:
    """Return the options by which pyogrio reads only buildings near a region, and only columns that describe buildings.

    The box to read is the one around all features that touch the region's surroundings: so everything that touches one
    of these features is read too (see `near_rows`). Without a CRS or geometry, or where no box holds the region, there
    are no options.
    """
    facts = pyogrio.read_info(source, layer=layer)
    if not (facts["crs"] and facts["geometry_type"]):
        return {}
    box = near.box_in(facts["crs"])
    if box is None:
        return {}

    # The features that touch the surroundings, by their boxes: `sides` is [4, N].
    _, sides = pyogrio.read_bounds(source, layer=layer, bbox=box)
    return {
        "bbox": extent_of(sides.T) if sides.size else box,
        "columns": [column for column in facts["fields"] if is_of_buildings(column)],
    }


def _polygon_layer(path: str | Path, source: str | Path | bytes, wanted: str) -> str:
    """Return the name of the layer of polygons in a file, which pyogrio opens as ``source``.

    It is the only layer, else the only one that may hold polygons, else the one of these that is called ``wanted``.

    Raises:
      InputError: there is no such layer.
    """
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(source)}
    if len(layers) == 1:
        return next(iter(layers))
    areal = [
        layer
        for layer, kind in layers.items()
        if "Polygon" in kind or "Unknown" in kind or "Surface" in kind
    ]
    if len(areal) != 1:
        areal = [layer for layer in areal if layer.lower() == wanted]
    if len(areal) != 1:
        raise InputError(
            f"{str(path)!r} has the layers {', '.join(layers) or 'none'}: call the one of polygons "
            f"{wanted!r}, or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    return areal[0]


def read_vector(path: str | Path, near: Near | None = None) -> Outlines:
    """Return the polygons of a vector file, with what its columns say of heights (see `tags_of`).

    Numbers are metres (or levels); text is read as OpenStreetMap's tags are. A collection counts as the
    polygons that it holds. Points and lines are left out and counted.

    Args:
      path: the file.
      near: the region whose surroundings are needed: what lies elsewhere may be left out. Of GeoPackages and
        Shapefiles it is not even decoded. None reads all.

    Raises:
      InputError: a file that cannot be read, has no CRS, or holds coordinates beyond the globe though its CRS is in
        degrees; a GeoPackage with several layers of polygons and not one of them called ``buildings``.
    """
    frame = open_frame(path, BUILDINGS, allow_empty=True, near=near)
    facts = frame.attrs  # empty of files that are not ours
    box = None if near is None else near.box_in(frame.crs.to_wkt())
    if box is not None:
        frame = frame[near_rows(shapely.bounds(frame.geometry.to_numpy()), box)]

    # Polygons, also those in collections, and places where a geometry is missing.
    shapes = np.array(frame.geometry, object)
    is_mixed = shapely.get_type_id(shapes) == shapely.GeometryType.GEOMETRYCOLLECTION
    shapes[is_mixed] = [polygonal(shape) for shape in shapes[is_mixed]]
    is_polygon = np.isin(shapely.get_type_id(shapes), POLYGONS) | shapely.is_missing(shapes)

    names = filter(is_of_buildings, frame)
    columns = {name: _values(frame.loc[is_polygon, name]) for name in names}
    issues = {ReadIssue(name): count for name, count in facts.get("issues", {}).items()}
    issues[ReadIssue.NON_POLYGONS] = int(np.sum(~is_polygon))
    return Outlines(
        polygons=shapes[is_polygon],
        tags=tags_of(columns),
        crs=frame.crs.to_wkt(),
        boxes=tuple(tuple(box) for box in facts.get("boxes", ())),
        issues=issues,
        attribution=facts.get("credit", ""),
        is_part=box is not None,
    )


def _scalar(value: Any) -> Any:
    """Return the value of a property; a list, a table or an array as its JSON text, so that no number is read of it."""
    if not isinstance(value, list | dict | tuple | np.ndarray):
        return value
    # What JSON cannot hold becomes a list or a text.
    return json.dumps(
        value, default=lambda inner: inner.tolist() if isinstance(inner, np.ndarray) else str(inner)
    )


def _values(column: pd.Series) -> np.ndarray:
    """Return a column's numbers as they are, and others as objects, None where there is none."""
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "fiu":
        return column.to_numpy()
    return column.astype(object).where(column.notna(), None).to_numpy()
