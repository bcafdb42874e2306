"""Buildings from any file that knows them: the reader is chosen by the file's suffix."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from jaxurban.city import Buildings, Raster
from jaxurban.errors import InputError
from jaxurban.grid import Bounds, projected_crs
from jaxurban.io.heights import MAX_HEIGHT_M
from jaxurban.io.osm import read_osm
from jaxurban.io.outlines import count_tags, to_buildings
from jaxurban.io.raster import raster_extent_m, read_raster
from jaxurban.io.vector import read_vector
from jaxurban.io.vectorfile import PARQUET_SUFFIXES

OSM_FORMATS = {".pbf": "pbf", ".osm": "osm"}
VECTOR_SUFFIXES = (".geojson", ".json", ".gpkg", ".shp", *PARQUET_SUFFIXES)
RASTER_SUFFIXES = (".tif", ".tiff", ".vrt", ".asc", ".img")
LOWEST_ROOF_M = -100.0  # surface minus terrain dips below 0 by noise, at cuttings by tens of metres


@dataclass(frozen=True)
class BuildingSource:
    """What a file of buildings holds: outlines, or a raster of roof heights.

    Attributes:
      buildings: outlines that stand, or None for a raster.
      roofs: roof heights above ground, or None for outlines.
      extent_m: x_min, y_min, x_max, y_max in the city's CRS that the whole file covers.
      faults: what was met, mended and left out in the whole file, counted by name (see `read_osm`, `read_vector`,
        `to_buildings`).
      counts: outlines of the whole file by tags, before any rule (see `count_tags`); empty for a raster.
    """

    buildings: Buildings | None
    roofs: Raster | None
    extent_m: Bounds
    faults: dict[str, int]
    counts: dict[str, int]


def read_buildings(
    path: str | Path,
    crs: str,
    *,
    bounds_m: Bounds | None = None,
    default_height_m: float = 10.0,
    level_height_m: float = 3.0,
) -> BuildingSource:
    """Return the buildings in a file.

    Args:
      path: ``.osm.pbf``, ``.osm``, ``.geojson``, ``.gpkg``, ``.shp``, ``.parquet``, or a height raster (``.tif``,
        ``.vrt``, ``.asc``, ``.img``), in any CRS that the file declares.
      crs: projected CRS of what comes back.
      bounds_m: x_min, y_min, x_max, y_max in ``crs``; buildings whose box does not touch it are left out. Which parts
        replace which outlines does not depend on it. None keeps all.
      default_height_m: height of a building without a usable height or levels.
      level_height_m: height of one level.

    Raises:
      InputError: no such file, an unknown suffix, a file that cannot be read or is in a wrong CRS, a height
        setting that is no height, or (raster) cells that are no heights.
    """
    projected_crs(crs)
    for name, value in (("default_height_m", default_height_m), ("level_height_m", level_height_m)):
        if not 0 < value <= MAX_HEIGHT_M:
            raise InputError(f"{name} must be above 0 and at most {MAX_HEIGHT_M:g} metres, got {value}")
    if not Path(path).is_file():
        raise InputError(f"{str(path)!r} is not there: check the path of the buildings")
    suffix = Path(path).suffix.lower()
    if suffix in RASTER_SUFFIXES:
        return _read_roofs(path, crs, bounds_m)
    if suffix in OSM_FORMATS:
        outlines = read_osm(path, OSM_FORMATS[suffix])
    elif suffix in VECTOR_SUFFIXES:
        outlines = read_vector(path)
    else:
        raise InputError(
            f"{str(path)!r} has the suffix {suffix!r}: buildings are read from "
            f"{', '.join((*OSM_FORMATS, *VECTOR_SUFFIXES, *RASTER_SUFFIXES))}"
        )
    buildings, extent_m, faults = to_buildings(
        path, outlines, crs, default_height_m=default_height_m, level_height_m=level_height_m
    )
    if bounds_m is not None:
        x_min, y_min, x_max, y_max = shapely.bounds(buildings.polygons).T
        buildings = buildings.take(
            (x_min <= bounds_m[2]) & (x_max >= bounds_m[0]) & (y_min <= bounds_m[3]) & (y_max >= bounds_m[1])
        )
    return BuildingSource(buildings, None, extent_m, faults, count_tags(outlines))


def _read_roofs(path: str | Path, crs: str, bounds_m: Bounds | None) -> BuildingSource:
    """Return a height raster; heights below 0 (noise of surface minus terrain) are ground and are counted."""
    raster = read_raster(path, crs, bounds_m, limits_m=(LOWEST_ROOF_M, MAX_HEIGHT_M))
    is_below = raster.values < 0
    roofs = replace(raster, values=np.where(is_below, np.float32(0), raster.values))
    faults = {"cells_below_ground": int(np.sum(is_below))}
    return BuildingSource(None, roofs, raster_extent_m(path, crs), faults, {})
