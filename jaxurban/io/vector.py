"""Building outlines from GeoJSON, GeoPackage, Shapefile and GeoParquet files."""

from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
import shapely

from jaxurban.io.heights import is_given
from jaxurban.io.outlines import Outlines, polygonal
from jaxurban.io.vectorfile import open_frame

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
        faults={"non_polygons": int(np.sum(~is_polygon))},
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
