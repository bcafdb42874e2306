"""Vector files of any format, opened the same way for every use, and the building outlines in them."""

import json
from functools import reduce
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely

from jaxurban.errors import InputError, readable
from jaxurban.io.read.heights import is_given
from jaxurban.io.read.outlines import Outlines, polygonal
from jaxurban.world.diagnostics import ReadIssue
from jaxurban.world.grid import check_on_earth

PARQUET_SUFFIXES = (".parquet", ".geoparquet")
VECTOR_SUFFIXES = (".geojson", ".json", ".gpkg", ".shp", *PARQUET_SUFFIXES)
# Columns by what they hold: in any case, with ":", "." and "_" the same; names of ten letters are cut, as Shapefiles
# cut them. Where several are there, the first that is filled counts, row by row. Column names in feet or of
# roof shapes ("roof:height" is the height of the roof alone) are left out on purpose.
COLUMNS = {
    "building": ("building",),
    "part": ("building_part", "building_p"),
    "height": ("height", "height_m", "building_height", "measuredheight", "measured_height", "measuredhe"),
    "levels": ("building_levels", "building_l", "levels", "num_floors", "storeysaboveground"),
    "roof_levels": ("roof_levels", "roof_level"),
    "min_height": ("min_height", "building_min_height"),
    "min_level": ("building_min_level", "min_level", "min_floor"),
    "location": ("location",),
    "layer": ("layer",),
}
OF_DAMAGED = (RuntimeError, LookupError, TypeError, AttributeError, shapely.errors.ShapelyError)  # raised by readers
_UNDERGROUND = "is_underground"  # of Overture Maps: true or false
_POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)


def open_frame(path: str | Path, role: str, *, allow_empty: bool = False) -> gpd.GeoDataFrame:
    """Return the features of a vector file (any format of GDAL, or GeoParquet), as they are.

    A ring of too few points becomes an empty place, and no error.

    Args:
      path: the file.
      role: what it holds, for messages; the layer of this name is taken where several hold polygons.
      allow_empty: accept a file without a single feature.

    Raises:
      InputError: no such file, not a readable vector file, no geometry, no CRS, coordinates beyond the globe though
        the CRS is in degrees, or several layers of polygons and not one of them called ``role``.
    """
    (frame,) = _read(path, role, every_layer=False)
    if not allow_empty and (frame.empty or frame.geometry.isna().all()):
        raise InputError(f"the {role} file {str(path)!r} holds no polygons: give a file of polygons")
    return frame


def open_layers(path: str | Path, role: str) -> list[gpd.GeoDataFrame]:
    """Return the features of every layer of a vector file, those without geometry left out.

    Every folder of a KML file is a layer. Nothing is passed over: a ring of too few points is an error.

    Raises:
      InputError: as `open_frame`, but for several layers.
    """
    return _read(path, role, every_layer=True)


def _read(path: str | Path, role: str, *, every_layer: bool) -> list[gpd.GeoDataFrame]:
    """Return the features of the one layer of polygons, or of every layer, checked."""
    name = f"the {role} file {str(path)!r}"
    remedy = "give a whole one, with its companions"
    with readable(name, "a vector file", remedy, *OF_DAMAGED):
        if not Path(path).exists():
            raise FileNotFoundError
        if Path(path).suffix.lower() in PARQUET_SUFFIXES:
            frames = [gpd.read_parquet(path)]
        else:
            layers = [layer for layer, _ in pyogrio.list_layers(path)] if every_layer else [_polygon_layer(path, role)]
            on_invalid = "raise" if every_layer else "ignore"
            frames = [pyogrio.read_dataframe(path, layer=layer, on_invalid=on_invalid) for layer in layers]
    frames = [frame for frame in frames if isinstance(frame, gpd.GeoDataFrame)]
    if not frames:
        raise InputError(f"{name} holds no geometry: give a file of polygons")
    for frame in frames:
        for column in frame.columns.difference([frame.geometry.name]):
            if pd.api.types.is_object_dtype(frame[column]):
                frame[column] = frame[column].map(_scalar)
        if frame.crs is None:
            raise InputError(
                f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN` "
                "(a Shapefile has it in its .prj)"
            )
        check_on_earth(name, frame.crs.to_wkt())
        x_min, y_min, x_max, y_max = frame.total_bounds
        if frame.crs.is_geographic and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
            raise InputError(
                f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the "
                "CRS that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` "
                "(GeoJSON is always in longitude and latitude)"
            )
    return frames


def _polygon_layer(path: str | Path, wanted: str) -> str:
    """Return the name of the layer of polygons: the only one, the only one of polygons, or ``wanted``."""
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(path)}
    if len(layers) == 1:
        return next(iter(layers))
    areal = [layer for layer, kind in layers.items() if "Polygon" in kind or "Unknown" in kind or "Surface" in kind]
    if len(areal) != 1:
        areal = [layer for layer in areal if layer.lower() == wanted]
    if len(areal) != 1:
        raise InputError(
            f"{str(path)!r} has the layers {', '.join(layers) or 'none'}: call the one of polygons "
            f"{wanted!r}, or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    return areal[0]


def read_vector(path: str | Path) -> Outlines:
    """Return the polygons of a vector file, with what its columns say of heights (see `COLUMNS`).

    Numbers are metres (or levels); text is read as OpenStreetMap's tags are. A collection counts as the
    polygons that it holds. Points and lines are left out and counted.

    Raises:
      InputError: a file that cannot be read, has no CRS, or holds coordinates beyond the globe though its CRS is in
        degrees; a GeoPackage with several layers of polygons and not one of them called ``buildings``.
    """
    frame = open_frame(path, "buildings", allow_empty=True)
    shapes = np.array(frame.geometry, object)
    is_mixed = shapely.get_type_id(shapes) == shapely.GeometryType.GEOMETRYCOLLECTION
    shapes[is_mixed] = [polygonal(shape) for shape in shapes[is_mixed]]
    is_polygon = np.isin(shapely.get_type_id(shapes), _POLYGONS) | shapely.is_missing(shapes)
    return Outlines(
        polygons=shapes[is_polygon],
        tags=_tags(frame[is_polygon]),
        crs=frame.crs.to_wkt(),
        boxes=(),
        issues={ReadIssue.NON_POLYGONS: int(np.sum(~is_polygon))},
    )


def _scalar(value: Any) -> Any:
    """Return a property, a list or a table as its JSON text, which is no number."""
    if not isinstance(value, list | dict | tuple | np.ndarray):
        return value
    return json.dumps(value, default=lambda inner: inner.tolist() if isinstance(inner, np.ndarray) else str(inner))


def _tags(frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """Return the columns that say something of buildings, under the names that `Outlines` knows."""
    columns = {str(column).lower().replace(":", "_").replace(".", "_"): frame[column] for column in frame.columns}
    values = {name: series.astype(object).where(series.notna(), None).to_numpy() for name, series in columns.items()}
    tags = {}
    for tag, names in COLUMNS.items():
        if found := [values[name] for name in names if name in values]:
            tags[tag] = reduce(lambda first, second: np.where(is_given(first), first, second), found)
    if _UNDERGROUND in values:
        is_below = np.array([str(value).lower() in ("true", "1") for value in values[_UNDERGROUND]], bool)
        tags["location"] = np.where(is_below, ReadIssue.UNDERGROUND, tags.get("location", np.array(None)))
    return tags
