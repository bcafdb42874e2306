"""Vector files, opened the same way for every use, and the building outlines in them."""

import json
import re
import sqlite3
from codecs import getincrementaldecoder
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely

from jaxurban import settings
from jaxurban.cities.bridges import is_raised
from jaxurban.cities.columns import is_of_buildings, named_columns, tags_of, tags_of_table
from jaxurban.cities.companions import REFERS, check_companions
from jaxurban.cities.heights import is_given
from jaxurban.cities.outlines import Near, Outlines
from jaxurban.cities.rules import BY_VALUE, IN_WORDS, KINDS
from jaxurban.cities.solids import openable, streamed
from jaxurban.cities.stands import is_water
from jaxurban.errors import GuessWarning, InputError, readable, warn
from jaxurban.io.geoparquet import read_geoparquet
from jaxurban.io.issues import ReadIssue
from jaxurban.io.sniff import (
    DATABASE,
    FLOWN,
    HEAD_BYTES,
    WKT_COLUMNS,
    in_own_words,
    sniff,
    unpacked,
)
from jaxurban.io.tables import check_rows
from jaxurban.world.extent import extent_of, meets
from jaxurban.world.grid import MOST_OF_CRS, OPENS_FILE, WGS84, Bounds, check_on_earth, known_crs

INDEXED_SUFFIXES = (
    ".gpkg",
    ".shp",
    ".fgb",
    ".sqlite",
    DATABASE,
)  # whose features are found by their boxes
JSON_SUFFIXES = (".geojson", ".geojsonl")
# What is read as outlines, by `sniff`; and other names of these formats.
VECTOR_SUFFIXES = (*JSON_SUFFIXES, ".csv", *INDEXED_SUFFIXES, ".parquet")
OTHER_SUFFIXES = (".json", ".geoparquet")
# Of any other format GDAL may read what the file names, even from a server.
FORMATS = (*VECTOR_SUFFIXES, ".kml", ".gpx")
DRIVERS = {".geojsonl": "GeoJSONSeq:", ".csv": "CSV:"}  # which GDAL would choose by the file's name
OPTIONS: dict[str, Any] = {"on_invalid": "ignore", "fid_as_index": True}
CSV_OPTIONS = {"GEOM_POSSIBLE_NAMES": WKT_COLUMNS, "KEEP_GEOM_COLUMNS": "NO"}
SAYS_CRS = "says_crs"  # of the format
BUILDINGS = "buildings"  # the role, and the layer of several
WHOLE = "give a whole one, with its companions"
# Options of GDAL while it reads: with these parts a table of a database may be any other file, and PROJ's own files are
# looked for in the current folder too.
ALONE = {"SPATIALITE_LOAD": False, "OGR_SQLITE_STATIC_VIRTUAL_OGR": False}
# Files that refer to others are refused before GDAL sees them.
REFERRING = re.compile(  # the last two name files in WKT of a CRS, which GDAL opens as it reads
    "<ogr(vrt|wfs|elastic)datasource|gdal_streamed_alg|proj4_grids|parameterfile"
)
ESCAPE = re.compile(r"\\u00([2-7][0-9a-fA-F])")  # a plain letter of JSON in digits
BLANKS = re.compile(r"\s+")
MEMBER = re.compile(r'"crs"\s*:\s*(?=\{)')  # of the GeoJSON of 2008
LINK = re.compile(r'"type"\s*:\s*"(link|url)"')
MOST_OF_WORD = 50  # letters of each of these words
POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)


def open_frame(path: str | Path, role: str) -> gpd.GeoDataFrame:
    """Return the features of a vector file (of `FORMATS`, packed or not), those without geometry too.

    A ring of too few points becomes an empty geometry, and no error.

    Args:
      path: the file.
      role: what it holds, for messages; the layer of this name is taken where several hold polygons.

    Raises:
      InputError: no such file, not a readable vector file, no geometry, no CRS, coordinates beyond the globe though
        the CRS is in degrees, or several layers of polygons and not one of them called ``role``.
    """
    (frame,) = _read(path, role)
    if frame.empty or frame.geometry.isna().all():
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
    path: str | Path,
    role: str,
    *,
    every_layer: bool = False,
    near: Near | None = None,
    named: Collection[str] | None = None,
    crs: str | None = None,
) -> list[gpd.GeoDataFrame]:
    """Return the features of the one layer of polygons, or of every layer, checked; see `open_frame`, `open_layers`.

    Args:
      path, role: as of `open_frame`.
      every_layer: as of `open_layers`.
      near: a region: features of GeoPackages, Shapefiles and FlatGeobuf that are not near it are left out.
      named: the only columns to read, with those that describe buildings (`is_of_buildings`); None: all. Only Parquet,
        and files that are read near a region, leave columns out.
      crs: in place of the one that the file declares.
    """
    name = f"the {role} file {str(path)!r}"
    with readable(path, "a vector file", WHOLE, what=name), unpacked(path) as plain:
        kind = _checked_format(Path(path), plain)
        region = near if crs is None and kind in INDEXED_SUFFIXES else None
        layers: list[pd.DataFrame]
        with in_own_words(), _alone():
            if kind == ".parquet":
                layers = [_read_parquet(plain, named)]
            elif every_layer:
                layers = _every_layer(plain, kind)
            else:
                layers = [_polygon_layers(plain, kind, name, role, region, named or ())]
            if kind == ".geojsonl" and not every_layer:
                _check_lines(plain, sum(map(len, layers)))

    frames = [layer for layer in layers if isinstance(layer, gpd.GeoDataFrame)]
    if not frames:
        raise InputError(f"{name} holds no geometry: give a file of polygons")
    for frame in frames:
        _check_columns(name, frame)
        _place(name, frame, kind, crs)
        _write_out(frame)
    return frames


def _check_columns(name: str, frame: pd.DataFrame) -> None:
    """Raise InputError where two columns of a file, ``name``, are called the same."""
    twice = frame.columns[frame.columns.duplicated()]
    if len(twice):
        raise InputError(
            f"{name} has several columns called {twice[0]!r}: rename or leave out all but one"
        )


def _write_out(frame: gpd.GeoDataFrame) -> None:
    """Put texts in the place of values that hold several (see `_scalar`)."""
    for column in frame.columns.difference([frame.geometry.name]):
        if pd.api.types.is_object_dtype(frame[column]):
            frame[column] = frame[column].map(_scalar)


@contextmanager
def _alone() -> Iterator[None]:
    """Let GDAL open nothing beside the file that the block reads (`ALONE`)."""
    before = {name: pyogrio.get_gdal_config_option(name) for name in ALONE}
    pyogrio.set_gdal_config_options(ALONE)
    try:
        yield
    finally:
        pyogrio.set_gdal_config_options(before)


def _every_layer(path: Path, kind: str) -> list[pd.DataFrame]:
    """Return the features of each layer of a file, unpacked, of a format; a ring of too few points is an error."""
    source = (DRIVERS | {".geojson": "GeoJSON:"}).get(kind, "") + str(path)
    options = OPTIONS | {"on_invalid": "raise"} | (CSV_OPTIONS if kind == ".csv" else {})
    return [_features(source, layer, options) for layer, _ in pyogrio.list_layers(source)]


def _polygon_layers(
    path: Path, kind: str, name: str, role: str, near: Near | None, named: Collection[str]
) -> pd.DataFrame:
    """Return the features of the layer of polygons and of those that go with it (see `_layers_of`).

    Solids of buildings come with their faces.

    Args:
      path, kind: of the file, unpacked, and its format.
      name: of the file, for messages.
      role, near, named: as of `_read`; features that are not near are left out.
    """
    source: str | bytes = DRIVERS[kind] + str(path) if kind in DRIVERS else openable(str(path))
    lacks_solids = role == BUILDINGS and isinstance(source, str)  # a stream brings them
    frames = []
    for layer in _layers_of(source, name, role):
        options = OPTIONS | (CSV_OPTIONS if kind == ".csv" else {})
        if near is not None:
            options |= _only_near(source, layer, near, named)
        frame = _features(source, layer, options)
        if lacks_solids:
            _fill_solids(frame, str(path), kind, layer, options)
        frames.append(frame)

    # pandas warns where empty columns are joined with others, as they may decide the type.
    filled = [frame.dropna(axis=1, how="all") for frame in frames if len(frame)]
    if len(frames) == 1 or not filled:
        return frames[0]
    return pd.concat(filled, ignore_index=True)


def _features(source: str | bytes, layer: str | None, options: Mapping[str, Any]) -> pd.DataFrame:
    """Return the features of a layer as pyogrio reads them, in the order of the file whatever its index says."""
    frame = pyogrio.read_dataframe(source, layer=layer, **options)
    return frame.sort_index().reset_index(drop=True)


def _fill_solids(
    frame: pd.DataFrame, path: str, kind: str, layer: str, options: Mapping[str, Any]
) -> None:
    """Fill geometries that pyogrio leaves out, since they are PolyhedralSurfaces or TINs, with their faces.

    Args:
      frame: changed in place.
      path, kind: of the file, and its format.
      layer, options: as of `_features`.
    """
    if not isinstance(frame, gpd.GeoDataFrame) or not frame.geometry.isna().any():
        return
    how = f"--input-layer {json.dumps(layer, ensure_ascii=False)}"
    if kind == ".csv":
        how = "--input-format CSV " + " ".join(f"--oo {k}={v}" for k, v in CSV_OPTIONS.items())
    plain = {name: value for name, value in options.items() if name not in CSV_OPTIONS}
    faces = _features(streamed(path, how), None, plain)
    if len(faces) == len(frame):
        frame.geometry = frame.geometry.where(frame.geometry.notna(), faces.geometry)


def _read_parquet(path: Path, named: Collection[str] | None) -> gpd.GeoDataFrame:
    """Return the features of a GeoParquet file, with the facts of its metadata as ``attrs``.

    Without metadata of GeoParquet shapes are WKB in the first binary column, without a CRS.

    Args:
      path: to read.
      named: read only geometries, these columns, and those that describe buildings (`is_of_buildings`); None: all.
    """
    import pyarrow.parquet as pq  # imported here: it takes 0.1 s to load, for which other formats need not wait

    schema = pq.read_schema(path)
    facts = (schema.metadata or {}).get(b"geo")
    if facts is None:
        shapes = [field.name for field in schema if "binary" in str(field.type)][:1]
        frame = pd.read_parquet(path, columns=_columns_to_read(schema.names, shapes, named))
        if shapes:
            frame = gpd.GeoDataFrame(frame, geometry=gpd.GeoSeries.from_wkb(frame[shapes[0]]))
        frame.attrs[SAYS_CRS] = False
        return frame

    shapes = json.loads(facts or b"{}").get("columns", {})
    frame = read_geoparquet(path, _columns_to_read(schema.names, shapes, named))
    # Columns that pandas wrote as an index.
    index = [name for name in frame.index.names if name is not None and name not in frame.columns]
    return frame.reset_index(level=index)


def _columns_to_read(
    names: list[str], shapes: Collection[str], named: Collection[str] | None
) -> list[str]:
    """Return which columns to read: shapes, and others by ``named`` as of `_read_parquet`."""
    if named is None:
        return names
    return [name for name in names if name in shapes or is_of_buildings(name, named)]


def _checked_format(path: Path, plain: Path) -> str:
    """Return the format of a file, one of `FORMATS`, that refers to no other file or server.

    Args:
      path: of the file.
      plain: of its content, unpacked.

    Raises:
      InputError: a folder, or another format.
      ValueError: it does not begin as its suffix says, or refers to others.
    """
    kind = sniff(plain)
    if kind == DATABASE:
        return kind
    if kind not in FORMATS:
        suffix = path.suffix.lower()
        if kind == ".txt" or (not kind and suffix == ".csv"):
            raise InputError(
                f"{str(path)!r} is a table without shapes, as it has no column {WKT_COLUMNS.replace(',', ' or ')} of "
                "WKT: if columns are longitude and latitude, make points of it with `ogr2ogr -a_srs EPSG:4326 -oo "
                "X_POSSIBLE_NAMES=LON -oo Y_POSSIBLE_NAMES=LAT points.gpkg FILE`, and name what stands there in "
                "columns such as kind and height, or height_hub and rotor_diameter of wind turbines"
            )
        if not kind and suffix in (*FORMATS, *OTHER_SUFFIXES):
            raise ValueError(f"it does not begin as a {suffix} file does")
        if kind in FLOWN:
            raise InputError(
                f"{str(path)!r} is a mission, and no lines or outlines: `jaxurban check` reads it; save routes as "
                ".geojson, .kml or .gpx"
            )
        raise InputError(
            f"{str(path)!r} is of a format that is not read: unpack it, or make a GeoPackage of it with `ogr2ogr`"
        )
    if kind in JSON_SUFFIXES:
        _check_json(plain)
    with plain.open("rb") as file:
        _check_refers(REFERRING, file.read(HEAD_BYTES).decode("latin-1").lower())
    if kind in (".shp", ".csv"):
        check_companions(plain)
    if kind == ".csv":
        check_rows(plain, path.name)
    if kind in (".gpkg", ".sqlite"):
        _check_views(plain)
    return kind


def _check_views(path: Path) -> None:
    """Raise ValueError where a view of a database may never end."""
    address = f"{path.absolute().as_uri()}?immutable=1"  # so that nothing is written beside it
    of_itself = "SELECT 1 FROM sqlite_master WHERE type = 'view' AND sql LIKE '%with%'"
    with in_own_words(sqlite3.Error), closing(sqlite3.connect(address, uri=True)) as base:
        is_endless = base.execute(of_itself).fetchone()
    if is_endless:
        raise ValueError(
            "it has a view that may never end: write its rows to a file with `ogr2ogr`"
        )


def _check_json(path: Path) -> None:
    """Raise ValueError where JSON is not in UTF-8, or refers to what GDAL would open: by a CRS, to servers too.

    Each piece is looked at with the end of the one before: its last letters, as a word may lie across both, or all
    from a CRS on that does not end in it.
    """
    rest = ""
    for piece in _pieces_of_json(path):
        text = _plain_json(rest + piece)
        crs_begins = _check_crs_members(text)
        _check_refers(REFERRING, text)
        word_begins = max(len(text) - MOST_OF_WORD, 0)
        rest = text[min(crs_begins, word_begins) :]
        _check_crs_ends(rest, MOST_OF_CRS)
    # More than a word is left only from a CRS on.
    _check_crs_ends(rest, MOST_OF_WORD)


def _check_crs_ends(rest: str, most: int) -> None:
    """Raise ValueError where more characters are left of a text than may be left if each CRS in it ends."""
    if len(rest) > most:
        raise ValueError(f"it has a CRS without an end, or of more than {MOST_OF_CRS:,} characters")


def _pieces_of_json(path: Path) -> Iterator[str]:
    """Yield the text of a file in pieces; ValueError where it is not in UTF-8."""
    decoder = getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        while piece := file.read(HEAD_BYTES):
            try:
                yield decoder.decode(piece)
            except UnicodeDecodeError:
                raise ValueError(
                    "it is not in UTF-8: convert it, as with `iconv -f LATIN1 -t UTF-8`"
                ) from None


def _plain_json(text: str) -> str:
    """Return JSON in small letters, those in digits too, and near a CRS with one blank for several."""
    plain = ESCAPE.sub(lambda match: chr(int(match[1], 16)), text).lower()
    return BLANKS.sub(" ", plain) if '"crs"' in plain else plain


def _check_crs_members(text: str) -> int:
    """Return where a CRS begins that does not end in a text, or else the end; ValueError where one refers to others."""
    for member in MEMBER.finditer(text):
        try:
            crs, end = json.JSONDecoder().raw_decode(text, member.end())
        except (json.JSONDecodeError, RecursionError):
            return member.start()
        _check_refers(LINK, text[member.end() : end])
        _check_refers(OPENS_FILE, str(crs))
    return len(text)


def _check_lines(path: Path, num_read: int) -> None:
    """Raise ValueError where a sequence of GeoJSON (RFC 8142, or a feature a line) holds more than was read of it."""
    marks, lines = 0, 0
    with path.open("rb") as file:
        for line in file:
            marks += line.startswith(b"\x1e")
            lines += not line.isspace()
    if (marks or lines) > num_read:
        raise ValueError("features of it cannot be read")


def _check_refers(pattern: re.Pattern[str], text: str) -> None:
    """Raise ValueError where a text refers to other files or servers, by a pattern."""
    if pattern.search(text):
        raise ValueError(REFERS)


def _place(name: str, frame: gpd.GeoDataFrame, kind: str, crs: str | None) -> None:
    """Give a frame its CRS, and check its place on the Earth.

    Args:
      name: of the file, for messages.
      frame: changed in place.
      kind: the format of its file.
      crs: in place of the one that the file declares.

    Raises:
      InputError: no CRS, one that is no place on the Earth, or coordinates beyond the globe though it is in degrees.
    """
    if crs is not None:
        frame.set_crs(crs, allow_override=True, inplace=True)
    if frame.crs is None and not frame.attrs.get(SAYS_CRS, kind != ".csv"):
        frame.set_crs(WGS84, inplace=True)
        warn(
            f"{name} cannot say its CRS: its coordinates are taken for longitude and latitude (EPSG:4326); convert "
            "others with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN`, or set [buildings] crs of buildings",
            GuessWarning,
        )
    if frame.crs is None:
        raise InputError(
            f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN` "
            "(a Shapefile has it in its .prj), or set [buildings] crs if it is that of buildings"
        )
    check_on_earth(name, known_crs(frame.crs.srs, f" of {name}"), frame.total_bounds)
    x_min, y_min, x_max, y_max = frame.total_bounds
    if frame.crs.is_geographic and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
        raise InputError(
            f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the "
            "CRS that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` "
            "(GeoJSON is always in longitude and latitude)"
        )


def _only_near(
    source: str | bytes, layer: str, near: Near, named: Collection[str]
) -> dict[str, Any]:
    """Return the options by which pyogrio reads buildings near a region, and columns of buildings or named.

    The box to read is the one around all features that touch the region's surroundings: so everything that touches one
    of these features is read too, as in `read_vector`. Without a CRS or geometry, or where no box holds the region,
    there are no options.
    """
    facts = pyogrio.read_info(source, layer=layer)
    box = facts["geometry_type"] and facts["crs"] and near.box_in(facts["crs"])
    if not box:
        return {}

    # The features that touch the surroundings, by their boxes: `sides` is [4, N].
    _, sides = pyogrio.read_bounds(source, layer=layer, bbox=box)
    return {
        "bbox": extent_of(sides.T) if sides.size else box,
        "columns": [column for column in facts["fields"] if is_of_buildings(column, named)],
    }


def _layers_of(source: str | bytes, name: str, role: str) -> list[str]:
    """Return the layer of polygons in what pyogrio opens, and layers that go with it; messages call it ``name``.

    It is the only layer, else the only one that may hold polygons, else the one of these that is called ``role``. With
    that of buildings go those of lines and points that GDAL makes of OpenStreetMap.

    Raises:
      InputError: there is no such layer.
    """
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(source)}
    if len(layers) == 1:
        return list(layers)
    areal = [
        layer
        for layer, kind in layers.items()
        if "Polygon" in kind or "Unknown" in kind or "Surface" in kind
    ]
    chosen = areal if len(areal) == 1 else [layer for layer in areal if layer.lower() == role]
    if len(chosen) != 1:
        raise InputError(
            f"{name} has the layers {', '.join(layers) or 'none'}: call the one of polygons "
            f"{role!r}, or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    if role == BUILDINGS and chosen == ["multipolygons"]:
        return chosen + [layer for layer in ("lines", "points") if layer in layers]
    others = [layer for layer, kind in layers.items() if kind != "None" and layer not in chosen]
    if role == BUILDINGS and others:
        warn(
            f"{name} is read from its layer {chosen[0]!r} alone: what stands in {', '.join(map(repr, others))} is left "
            "out; if anything does, put it into that layer with `ogr2ogr -append`",
            GuessWarning,
        )
    return chosen


def read_vector(
    path: str | Path,
    near: Near | None = None,
    file: settings.Buildings | None = None,
    crs: str | None = None,
    beside: Path | None = None,
) -> Outlines:
    """Return the polygons of a vector file, with what its columns say of heights (see `tags_of_table`).

    Text is read as OpenStreetMap's tags are. A collection counts as the polygons that it holds. Points and lines whose
    columns do not say what stands there are left out and counted.

    Args:
      path: the file.
      near: the region whose surroundings are needed: what lies elsewhere may be left out. Of GeoPackages,
        Shapefiles and FlatGeobuf it is not even decoded. None reads all.
      file: what the settings say of its columns. None: columns are known by name alone (`tags_of`), and nothing of
        their heights is checked.
      crs: in place of the one that the file declares.
      beside: another file of the same CRS and credit, whose features come after those of ``path``.

    Raises:
      InputError: a file that cannot be read, has no CRS, or holds coordinates beyond the globe though its CRS is in
        degrees; a GeoPackage with several layers of polygons and not one of them called ``buildings``; as of
        `tags_of_table`.
    """
    named = [] if file is None else named_columns(file)
    (frame,) = _read(path, BUILDINGS, near=near, named=named, crs=crs)
    facts = frame.attrs  # empty of files that are not ours; joined frames lose them
    if beside is not None:
        frame = pd.concat([frame, *_read(beside, BUILDINGS)], ignore_index=True)
    box = None if near is None else near.box_in(frame.crs.to_wkt())
    if box is not None:
        frame = _with_neighbours(frame, box)
    columns = {name: _values(frame[name]) for name in frame if is_of_buildings(name, named)}
    outlines = Outlines(
        polygons=without_collections(np.array(frame.geometry, object)),
        tags=tags_of(columns) if file is None else tags_of_table(columns, file, frame.crs),
        crs=frame.crs.to_wkt(),
        boxes=tuple(tuple(box) for box in facts.get("boxes", ())),
        issues={ReadIssue(name): count for name, count in facts.get("issues", {}).items()},
        attribution=facts.get("credit", ""),
        is_part=box is not None,
    )
    is_kept = _what_may_stand(outlines)
    kept = outlines.take(is_kept)
    is_ring = shapely.is_ring(kept.polygons)
    kept.polygons[is_ring] = [shapely.Polygon(ring) for ring in kept.polygons[is_ring]]
    return replace(kept, issues={**outlines.issues, ReadIssue.NON_POLYGONS: int(np.sum(~is_kept))})


def _with_neighbours(frame: gpd.GeoDataFrame, box: Bounds) -> gpd.GeoDataFrame:
    """Return the features that touch the box around those that touch a region's, and those without a shape.

    So every outline comes with all its parts, and every part with its outline, however large they are; what has no
    shape may stand anywhere.
    """
    boxes = frame.bounds.to_numpy()
    near_box = extent_of(boxes[meets(boxes, box)])
    return frame[meets(boxes, near_box) | frame.geometry.isna()]


def _what_may_stand(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` which features are areas or lack a shape, and which points and lines their columns name."""
    shapes = outlines.polygons
    may_stand = np.isin(shapely.get_type_id(shapes), POLYGONS) | shapely.is_missing(shapes)
    for key in outlines.tags.keys() & {"building", "part", "height", *KINDS}:
        may_stand |= is_given(outlines.tags[key])
    for key, values in (*BY_VALUE.items(), *IN_WORDS.items()):
        may_stand |= outlines.says(key, values)
    return may_stand | is_water(outlines) | is_raised(outlines)


def without_collections(shapes: np.ndarray) -> np.ndarray:
    """Return shapes ``[N]``, in place of each collection the polygons that it holds, if it holds any."""
    is_mixed = shapely.get_type_id(shapes) == shapely.GeometryType.GEOMETRYCOLLECTION
    polygons = shapes.copy()
    for index in np.flatnonzero(is_mixed):
        parts = shapely.get_parts(shapely.get_parts(shapes[index]))
        areal = parts[shapely.get_dimensions(parts) == 2]
        if len(areal):
            polygons[index] = shapely.multipolygons(areal)
    return polygons


def _scalar(value: Any) -> Any:
    """Return the value of a property; a list, a table, an array or bytes as JSON text: no number is read of it."""
    if not isinstance(value, list | dict | tuple | bytes | np.ndarray):
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
