"""Building outlines from GeoJSON, GeoPackage, Shapefile and GeoParquet files."""

from functools import reduce
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely

from jaxurban.errors import InputError
from jaxurban.io.heights import is_given
from jaxurban.io.outlines import Outlines, polygonal

PARQUET_SUFFIXES = (".parquet", ".geoparquet")

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
_UNDERGROUND = "is_underground"  # of Overture Maps: true or false
_POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)


def read_vector(path: str | Path) -> Outlines:
    """Return the polygons of a vector file, with what its columns say of heights (see `COLUMNS`).

    Numbers are metres (or levels); text is read as OpenStreetMap's tags are. A collection counts as the
    polygons that it holds. Fault: ``non_polygons``, features left out because they are points or lines.

    Raises:
      InputError: a file that cannot be read, has no CRS, or holds coordinates beyond the globe though its CRS is in
        degrees; a GeoPackage with several layers of polygons of which none is called ``buildings``.
    """
    name = repr(str(path))
    try:
        if Path(path).suffix.lower() in PARQUET_SUFFIXES:
            frame = gpd.read_parquet(path)
        else:
            # A ring of too few points becomes an empty place, which is counted, and no error.
            frame = pyogrio.read_dataframe(path, layer=_polygon_layer(path), on_invalid="ignore")
    except InputError:
        raise
    except (RuntimeError, ValueError, OSError, shapely.errors.ShapelyError) as error:
        reason = " ".join(str(error).split())  # some libraries' messages have several lines
        raise InputError(
            f"{name} cannot be read as a vector file ({reason}): give a whole one, with its companions"
        ) from error
    if not isinstance(frame, gpd.GeoDataFrame):
        raise InputError(f"{name} holds no geometry: give a file of building outlines")
    if frame.crs is None:
        raise InputError(f"{name} declares no CRS: write it into the file, as with `ogr2ogr -a_srs EPSG:... OUT IN`")
    shapes = np.array(frame.geometry, object)
    _check_degrees(name, frame.crs.is_geographic, shapes)
    is_mixed = shapely.get_type_id(shapes) == shapely.GeometryType.GEOMETRYCOLLECTION
    shapes[is_mixed] = [polygonal(shape) for shape in shapes[is_mixed]]
    is_polygon = np.isin(shapely.get_type_id(shapes), _POLYGONS) | shapely.is_missing(shapes)
    return Outlines(
        polygons=shapes[is_polygon],
        tags=_tags(frame[is_polygon]),
        crs=frame.crs.to_wkt(),
        box=None,
        faults={"non_polygons": int(np.sum(~is_polygon))},
    )


def _polygon_layer(path: str | Path) -> str:
    """Return the name of the layer with the outlines: the only one, the only one of polygons, or ``buildings``."""
    layers = {str(layer): str(kind) for layer, kind in pyogrio.list_layers(path)}
    if len(layers) == 1:
        return next(iter(layers))
    areal = [layer for layer, kind in layers.items() if "Polygon" in kind or "Unknown" in kind or "Surface" in kind]
    if len(areal) != 1:
        areal = [layer for layer in areal if layer.lower() == "buildings"]
    if len(areal) != 1:
        raise InputError(
            f"{str(path)!r} has the layers {', '.join(layers) or 'none'}: call the one of building polygons "
            "'buildings', or write it to a file of its own with `ogr2ogr OUT IN LAYER`"
        )
    return areal[0]


def _check_degrees(name: str, is_in_degrees: bool, shapes: np.ndarray) -> None:
    x_min, y_min, x_max, y_max = shapely.total_bounds(shapes)
    if is_in_degrees and (max(-x_min, x_max) > 360 or max(-y_min, y_max) > 90):
        raise InputError(
            f"{name} is in degrees by its CRS but has coordinates such as {x_max:.0f}, {y_max:.0f}: declare the CRS "
            "that they are in, or convert them with `ogr2ogr -s_srs EPSG:... -t_srs EPSG:4326 OUT IN` (GeoJSON is "
            "always in longitude and latitude)"
        )


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
        tags["location"] = np.where(is_below, "underground", tags.get("location", np.array(None)))
    return tags
